"""Messages as bytes: ROS 2's CDR, and protobuf."""
