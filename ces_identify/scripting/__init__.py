"""What scripts and notebooks use: recordings, models and a scikit-learn estimator as objects with methods."""

from ces_data.compilation import CompilationNotice
from ces_data.findings import warn

CompilationNotice(warn)  # at the line of the script that waits for it
