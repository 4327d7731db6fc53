"""The black box: the last seconds of raw messages, and rosbag2 folders written from them."""
