"""Match rendered views of objects in a picture with LINE-2D; runs where OpenCV comes with its contributed modules.

    python matcher.py VIEWS.npz FOUND.npz

VIEWS.npz: ``picture`` (h, w, 3); of each object N ``views_N`` (n, vh, vw) grey levels and ``corners_N`` (n, 2), where
each view's upper left pixel lies in the picture; ``reach_px``, how far a view may be shifted. FOUND.npz: of each object
``found_N`` (k, 4): view, shift to the right and down in pixels, similarity in percent; the most similar first.
"""

import sys
import time

import cv2
import numpy as np

LEAST = 55.0  # percent, OpenCV's example asks for 80, and finds less
MOST = 50  # of each object


def main() -> int:
    """Match all objects of a file."""
    given = np.load(sys.argv[1])
    found = {}
    begun_s = time.process_time()
    for name in sorted(key.removeprefix("views_") for key in given if key.startswith("views_")):
        found[f"found_{name}"] = matched(
            given["picture"], given[f"views_{name}"], given[f"corners_{name}"], float(given["reach_px"])
        )
    np.savez(sys.argv[2], took_s=time.process_time() - begun_s, **found)
    return 0


def matched(picture: np.ndarray, views: np.ndarray, corners: np.ndarray, reach_px: float) -> np.ndarray:
    """What is found of one object, (k, 4) as the module has it."""
    detector = cv2.linemod.getDefaultLINE()
    boxes = {}
    for number, view in enumerate(views):
        seen = cv2.cvtColor(view, cv2.COLOR_GRAY2BGR)
        template, box = detector.addTemplate([seen], "object", (view > 0).astype(np.uint8) * 255)
        if template >= 0:
            boxes[template] = (number, box)
    rows = []
    for match in detector.match([picture], LEAST, ["object"])[0]:
        number, box = boxes[match.template_id]
        shift = np.array([match.x - box[0], match.y - box[1]]) - corners[number]
        if np.abs(shift).max() <= reach_px:
            rows.append((number, *shift, match.similarity))
    rows.sort(key=lambda row: -row[3])
    return np.array(rows[:MOST], dtype=np.float64).reshape(-1, 4)


if __name__ == "__main__":
    sys.exit(main())
