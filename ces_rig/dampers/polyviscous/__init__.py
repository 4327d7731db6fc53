"""The electro-rheological damper: a yield force and viscous branches with a knee."""
