"""The magneto-rheological damper: a modified Bouc-Wen model."""
