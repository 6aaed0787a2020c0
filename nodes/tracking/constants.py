"""Constants that several rooms of the tracker share: unit, reason, and what sets each.

What is in one room alone stands there. What each does to the figures is measured by ``benchmarks/sensitivities.py``.
"""

from __future__ import annotations

# Control points. Of an object of which fewer should be seen an image says nothing: of ten the share that is found errs
# by 0.15, a standard deviation of the binomial, about as far as scores that decide are apart.
LEAST_SHOWN = 10.0

# Cosine. Lines at less than 26° may be taken for one another: there a peak moves along a line by less than half of what
# it moves across.
PARALLEL = 0.9

# Share of a score. To what an image supports by less than this part of what the one before did, something happens: of
# 590 such pairs of objects at rest (generator A, hidden, low contrast, pushed before the push) none is less than 0.88.
LESS = 0.85

# Share of a push's motion. What is predicted to move by less rests; a push is that far behind after 14 images.
AT_REST = 0.1

# Pixels, standard deviation. How far an outline is found beside its model's as a whole, all along it and from image to
# image: light, blur, the shadow at an object's foot. What is off by more is trusted less.
WHOLE_PX = 0.2

# Nats for every variance by which colours beside a peak are off what is remembered: a Gaussian's.
STRANGE_WEIGHT = 0.5
