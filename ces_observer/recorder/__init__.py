"""The black box: keeps the last seconds of raw messages and writes them as a rosbag2 folder when the model drifts."""
