"""Models for other programs: a model goes in, C99 source or an FMI 2.0 co-simulation FMU comes out."""
