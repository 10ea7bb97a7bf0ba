"""ROS 1 and ROS 2 bags and MCAP files: containers and the messages in them."""
