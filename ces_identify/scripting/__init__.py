"""What scripts and notebooks use: recordings, models and a scikit-learn estimator as objects with methods."""
