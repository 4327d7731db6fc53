"""The black box: the last seconds of raw messages go in, a rosbag2 folder comes out when something went wrong."""
