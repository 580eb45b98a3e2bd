"""Where to fly and how: missions, paths and the plain controllers that fly them alone.

A *mission* is a path of straights and arcs by shape; a *route* tells where to fly next. A
*controller* turns that into actuator commands, a *pilot* flies a ground station's goals.
"""
