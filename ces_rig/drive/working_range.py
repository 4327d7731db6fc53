"""The working range of the valve's current on the rig: the part of its allowed range that the experiments use."""

LOW, HIGH = 0.29, 0.70  # [A] what the controller reg1 of the thesis used (section 5.1)
