"""Serialised ROS 2 messages (CDR): reads one number and the stamp from bytes, and writes estimates as bytes."""
