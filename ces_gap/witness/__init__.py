"""A second opinion: the parameters of a physical model refitted to the real recordings, one group at a time."""
