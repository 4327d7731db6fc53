"""What rides on the vehicle: model file, differentiator and estimator (standard library only), and the ROS 2 nodes."""

__version__ = "0.1.0"
