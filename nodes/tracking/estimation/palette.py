"""What colours an object has, whatever the light: a likelihood in which whole faces count.

How often each chromaticity (red, green and blue by their sum: alike in light and in shadow) was seen on an object,
beside how often it is seen anywhere in the image: where all is gray, or of one colour, nothing is told. Of an object
whose colours nobody knows yet, that one face looks alike tells something (`painted`)."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned
from hierax.nodes.tracking.estimation.profiles import Image, Singles, grey_levels
from hierax.nodes.tracking.math.batched import summed
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.model.controls import Indices
from hierax.nodes.tracking.schema import Looks


class Coloured(NamedTuple):
    """Places beside the edges of poses, on the faces that are seen there."""

    colours: Singles  # (n, channels) grey levels
    owners: Indices  # (n,) which of the poses each is of
    visible: Floats  # (n,) chance that it is seen
    faces: Indices  # (n,) the number of the face, one body's others than another's


def palette_of(image: Image, looks: Sequence[Looks]) -> Floats | None:
    """(m, k) by how many nats each chromaticity is each object's, rather than any of an image's, by what is remembered
    of their looks. None: nothing is told, by a gray image, or as no object's colours are known.

    Args: image: of `hierax.nodes.tracking.estimation.profiles.smoothed`; looks: of each object."""
    if image.shape[2] != 3 or not any(each["dyed"] for each in looks):
        return None
    any_of = _soft(_shares(grey_levels(image[:: const.DYE_STEP, :: const.DYE_STEP]).reshape(-1, 3)))
    any_of = (1.0 - const.DYE_ANY) * any_of + const.DYE_ANY / len(any_of)
    known = np.stack([_soft(_cleaned(each["dye"])) if each["dyed"] else any_of for each in looks])
    counts = np.array([each["dyed"] for each in looks])[:, None]
    ratio = (counts * known / any_of + 1.0) / (counts + 1.0)
    return np.asarray(np.log(const.PAINTED * ratio + 1.0 - const.PAINTED))


def coloured(aligned: Aligned) -> Coloured:
    """What is seen on faces beside the edges that were found, or, where none was, beside where it was looked for."""
    controls, profiles = aligned.stage.controls, aligned.stage.profiles
    rows, reach = np.arange(len(controls.owners)), (profiles.places.shape[1] - 1) // 2
    found = np.isfinite(aligned.matches.pixels)
    places = np.where(found, profiles.places[rows, aligned.matches.columns], 0.0)
    places += np.where(found, aligned.matches.pixels, 0.0)
    columns = np.clip(np.rint(places), -reach, reach).astype(np.intp) + reach
    twice = np.nonzero(controls.creases)[0]
    which = np.concatenate((rows, twice))
    colours = np.concatenate((profiles.inside[rows, columns], profiles.outside[twice, columns[twice]]))
    patches = np.concatenate((controls.faces[:, 0], controls.faces[twice, 1])) + 1
    owners = controls.owners[which]
    return Coloured(colours, owners, controls.visible[which], owners * (int(patches.max(initial=0)) + 1) + patches)


def dyed(aligned: Aligned, palette: Floats | None, owners: Sequence[int] | Indices) -> Floats:
    """(m,) nats by which poses have the colours of their objects, rather than those of anything; owners: (m,) which of
    the palette's objects each is of."""
    said: Floats = dyed_as(aligned, palette, [owners])[0]
    return said


def dyed_as(aligned: Aligned, palette: Floats | None, owners: Sequence[Sequence[int] | Indices]) -> Floats:
    """(k, m) the same as if the poses were of some objects, and of others: k times (m,) whose they are."""
    count = len(aligned.poses)
    if palette is None:
        return np.zeros((len(owners), count))
    seen = coloured(aligned)
    numbers = _numbers(seen.colours)
    every = (palette[np.asarray(each)[seen.owners], numbers] for each in owners)
    said: Floats = np.stack([summed(seen.owners, seen.visible * nats, count) for nats in every])
    return const.PAINT_ALIKE * said


def is_another(colours: Floats | float) -> NDArray[np.bool_]:
    """Whether colours, nats of `dyed`, say that what is seen is something else."""
    return np.asarray(colours < -const.CLEAR_NATS)


def painted(aligned: Aligned) -> Floats:
    """(m,) nats by which, at each pose, what lies beside the edges of one face looks alike, rather than as anything."""
    seen = coloured(aligned)
    colours, count = seen.colours, len(aligned.poses)
    faces = np.unique(seen.faces, return_inverse=True)[1]
    varied = max(const.LEAST_VARIED, float(aligned.stage.profiles.outside.std(axis=(0, 1)).mean()))
    nats = np.zeros(len(faces))
    for face in range(int(faces.max(initial=-1)) + 1):
        own = np.nonzero(faces == face)[0]
        off = ((colours[own] - np.median(colours[own], axis=0)) ** 2).mean(axis=1)
        ratio = varied / const.PAINT * np.exp(0.5 * np.minimum(off / varied**2, 9.0) - 0.5 * off / const.PAINT**2)
        own_nats = np.log(const.PAINTED * ratio + 1.0 - const.PAINTED)
        nats[own] = own_nats * max(0.0, 1.0 - 4.0 / len(own))  # the face's own colour is not known before
    return const.PAINT_ALIKE * summed(seen.owners, seen.visible * nats, count)


def with_colours(looks: Looks, seen: Coloured, at: int, nats: float) -> Looks:
    """What is remembered of one object after an image; seen: of all of them; at: which one it is; nats: by how much its
    edges explain the image better than clutter does: it counts by how sure it is to be there."""
    own = (seen.owners == at) & (seen.visible > const.SURE_SEEN)
    if seen.colours.shape[1] != 3 or nats <= 0.0 or np.count_nonzero(own) < const.LEAST_SHOWN:
        return looks
    share, count = np.tanh(0.5 * nats), looks["dyed"]
    before = looks["dye"] if count else np.zeros(const.DYES**2)
    known = (count * before + share * _shares(seen.colours[own])) / (count + share)
    return {**looks, "dye": known.astype(np.float32), "dyed": min(float(count + share), const.OFFSET_FRAMES)}


def _cleaned(dye: Singles) -> Floats:
    """(k,) the shares of colours that a thing has, without what was seen beside it now and then."""
    main = np.where(dye > const.DYE_LEAST * dye.max(), dye, 0.0)
    return np.asarray(main / main.sum())


def _numbers(colours: Singles) -> Indices:
    """(n,) of grey levels (n, 3), by red's and green's share."""
    bright = colours + np.float32(1.0)
    share = bright[:, :2] / bright.sum(axis=1, keepdims=True)
    red, green = np.minimum((share * const.DYES).astype(np.intp), const.DYES - 1).T
    return np.asarray(red * const.DYES + green)


def _shares(colours: Singles) -> Floats:
    """(k,) in what share of grey levels (n, 3) each chromaticity is seen."""
    counts = np.bincount(_numbers(colours), minlength=const.DYES**2)
    return np.asarray(counts / max(len(colours), 1))


def _soft(shares: Floats) -> Floats:
    """(k,) the same with what is near to each."""
    square = shares.astype(np.float64).reshape(const.DYES, const.DYES)
    soft = cv2.GaussianBlur(square, (0, 0), const.DYE_SOFT, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(soft.ravel() / max(float(soft.sum()), 1e-9))
