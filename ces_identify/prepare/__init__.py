"""From recordings to series: channels as logged in, uniform ticks with speed and held current out.

The arithmetic is the observer's, so that a model is identified on the same speeds as on the vehicle.
"""
