"""The bridge that lets ArduPilot fly a HIL simulator, as PX4 does, through its own drivers.

ArduPilot has no HIL mode. On the HIL link the **bridge** acts as PX4; for ArduPilot it is the
physics of SITL's JSON backend (`json_physics`) and a VectorNav VN-200 on a serial device
(`vectornav`): IMU, compass, barometer and GPS reach EKF3 as bytes of a real sensor.
"""
