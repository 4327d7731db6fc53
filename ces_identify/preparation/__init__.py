"""From recordings to series: channels as logged go in, uniform ticks with speed and held current come out.

The arithmetic is the observer's own, so that a model is identified on the speeds that the vehicle will compute.
"""
