"""How certain a pose is: the probability that it is right, which is what an object that is tracked says of itself."""

from collections.abc import Sequence

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.model.symmetry import open_to
from hierax.nodes.tracking.schema import Symmetry


def present(nats: Floats, given: Floats | float = 1.0) -> Floats:
    """(m,) the probability that the image is explained by the object and not by clutter, both as likely before, by nats
    (m,) of `likelihood.explains` and `palette.dyed`; given: the probability of something else, if it is; then of
    both."""
    return np.asarray(given / (1.0 + np.exp(-np.clip(nats, -50.0, 50.0))))


def right(covariances: Floats, nats: Floats, symmetries: Sequence[Symmetry]) -> Floats:
    """(m,) the probability that poses are within 5 mm and 5° of the truth: that the image is explained by the object
    and not by clutter, both as likely before, and that an object which is there is no farther from its pose than its
    covariance (m, 6, 6), m² and rad², allows, but for what looks the same by its symmetry; nats: (m,) as for
    `present`."""
    twists = np.einsum("mij,sj->msi", np.linalg.cholesky(covariances), const.SAMPLES)
    for at, symmetry in enumerate(symmetries):
        if len(symmetry["free"]):
            twists[at] = twists[at] @ open_to(symmetry)
    near = np.linalg.norm(twists[..., :3], axis=2) < const.RIGHT_M
    near &= np.linalg.norm(twists[..., 3:], axis=2) < const.RIGHT_RAD
    return present(nats, near.mean(axis=1))
