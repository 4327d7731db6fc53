"""The virtual dyno rig: experiments and a hydraulic CES damper in, recordings out. All its data are synthetic."""
