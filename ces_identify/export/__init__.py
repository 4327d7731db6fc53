"""Models for other programs: a model goes in, C99 source, an FMI 2.0 co-simulation FMU or a C++ ROS 2 package out."""
