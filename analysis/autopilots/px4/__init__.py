"""PX4 in a run: how its program is started, with which parameters, and requests as MAVSDK makes
them."""
