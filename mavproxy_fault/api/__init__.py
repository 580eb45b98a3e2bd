"""The Python API: a proxy in this process or a running one, and whole flights.

`Proxy` is a proxy that a test holds; its `fault` gives a `LiveFault`. A `LocalProxy` runs the loop
in a thread here, a `RemoteProxy` speaks with another process over the bus; `Observed` keeps what
either says. `Run` is what one `mavproxy-fault run` left behind.
"""
