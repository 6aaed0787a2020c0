"""What is drawn for LINE-2D, and where its matches are put."""

import numpy as np
from line2d_rival.compare import MARGIN_PX, moved, view

from hierax.nodes.tracking.math.geometry import invert, looking_down, make_pose, project, transform
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.model.shapes import shape_of

INTRINSICS = np.array([520.0, 520.0, 319.5, 239.5])
CAMERA = looking_down(0.3, 0.9, 0.6, np.zeros(3))


def test_a_place_is_moved_on_the_table_along_the_pixels_ray() -> None:
    place = make_pose(np.eye(3), np.array([0.03, -0.02, 0.0]))
    shift = np.array([25.0, -40.0])
    there = moved(place, shift, CAMERA, INTRINSICS)
    before, after = (project(transform(invert(CAMERA), each[None, :3, 3]), INTRINSICS)[0] for each in (place, there))
    assert np.allclose(after - before, shift, atol=1e-9)
    assert np.allclose(there[2, 3], 0.0)
    assert np.array_equal(there[:3, :3], place[:3, :3])


def test_views_show_the_body_where_it_is_seen() -> None:
    mesh = box_mesh((0.05, 0.04, 0.03))
    pose = invert(CAMERA)
    image, corner = view(shape_of(mesh.vertices, mesh.faces), pose, INTRINSICS)
    pixels = project(transform(pose, mesh.vertices), INTRINSICS)
    rows, columns = np.nonzero(image)
    seen = np.array([columns.min(), rows.min()]) + corner
    assert np.allclose(seen, pixels.min(axis=0), atol=1.0)
    assert corner[0] <= pixels[:, 0].min() - MARGIN_PX
    assert len(np.unique(image)) == 4, "black, and the three sides that face the camera"
