"""A control law as a ros2_control controller: `export` puts the guarded C of `plant.realtime`
into a ROS 2 package.
"""
