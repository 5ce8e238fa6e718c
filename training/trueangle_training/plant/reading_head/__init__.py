"""Plant A, on which the diagnosis was developed.

Angles come from the exact geometry of a reading head over a displaced, oval grating; friction and heat are stepped
through the whole campaign; noise is a sum of Ornstein-Uhlenbeck processes with heavy tails, bursts and gaps.
"""
