"""The stage: bodies, table, lights and a finger in MuJoCo, which lets them fall and draws them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np
from bodies import Body, Form

from hierax.nodes.tracking.math.geometry import Array, Floats, invert, make_pose

SIZE = (640, 480)
INTRINSICS = np.array([602.0, 602.0, 323.3, 236.6])
OVER = 2  # pixels that are drawn for each of the camera's, along each axis
STEP_S = 1.0 / 1200.0
_SHADOWS_PX = 2048
_TABLE_M = (0.8, 0.65, 0.02)
_FINGER = 'type="capsule" size="0.008" fromto="0 0 0 0 0 0.3"'
_FLIP = np.diag([1.0, -1.0, -1.0])  # MuJoCo's cameras look along -z


@dataclass(frozen=True)
class Setting:
    """What a stage looks like; pictures are PNG."""

    table: bytes
    paints: Sequence[bytes]  # of each body
    lights: Sequence[tuple[Floats, float]]  # where, in metres, and how bright
    ambient: float
    shine: float
    finger: bool = False  # whether there is one, which no model is given of


class Stage:
    """Bodies on a table whose top is z = 0.

    Args:
        bodies: what there is; setting: how it looks.
    """

    def __init__(self, bodies: Sequence[Body], setting: Setting) -> None:
        pictures = {"table.png": setting.table}
        pictures.update({f"paint{at}.png": paint for at, paint in enumerate(setting.paints)})
        self._model = mujoco.MjModel.from_xml_string(_xml(bodies, setting), pictures)
        self._data = mujoco.MjData(self._model)
        self._forms = [body.real for body in bodies]
        self._finger = setting.finger
        owners = self._model.geom_bodyid - 1
        self._owners = np.where((owners >= 0) & (owners < len(bodies)), owners, -1)
        self._lights = self._model.light_pos.copy()
        self._renderer: mujoco.Renderer | None = None

    def place(self, poses: Sequence[Floats]) -> None:
        """Put the bodies to world_from_body, at rest."""
        self._data.qpos[:] = np.concatenate([_to_mujoco(pose) for pose in poses])
        self._data.qvel[:] = 0.0

    def point(self, tip_m: Floats) -> None:
        """Put the finger's tip somewhere."""
        self._data.mocap_pos[0] = tip_m

    def let_pass(self, time_s: float) -> None:
        """Let physics do."""
        for _ in range(round(time_s / STEP_S)):
            mujoco.mj_step(self._model, self._data)

    @property
    def state(self) -> Floats:
        """Where everything is."""
        return np.concatenate((self._data.qpos, self._data.mocap_pos.ravel()))

    @property
    def poses(self) -> Floats:
        """(n, 4, 4) world_from_body."""
        parts = self._data.qpos.reshape(-1, 7)
        rotation = np.zeros(9)
        made = []
        for part in parts:
            mujoco.mju_quat2Mat(rotation, part[3:])
            made.append(make_pose(rotation.reshape(3, 3), part[:3]))
        return np.array(made)

    @property
    def speed(self) -> float:
        """The fastest body's, in m/s."""
        return float(np.linalg.norm(self._data.qvel.reshape(-1, 6)[:, :3], axis=1).max())

    def resume(self, state: Floats) -> None:
        """Go back to where everything was."""
        count = len(self._data.qpos)
        self._data.qpos[:] = state[:count]
        self._data.mocap_pos[:] = state[count:].reshape(-1, 3)

    def draw(self, camera: Floats, shift_m: Floats) -> Array:
        """A picture, uint8 RGB, `OVER` times as large as the camera's, its lights moved by so much."""
        self._look(camera, shift_m)
        assert self._renderer is not None
        self._renderer.disable_segmentation_rendering()
        self._renderer.update_scene(self._data, "eye")
        return self._renderer.render()

    def labels(self, camera: Floats) -> Array:
        """Which body is seen where, -1 for none; as large as `draw`'s."""
        self._look(camera, np.zeros(3))
        assert self._renderer is not None
        self._renderer.enable_segmentation_rendering()
        self._renderer.update_scene(self._data, "eye")
        found = self._renderer.render()
        geoms = np.where(found[..., 1] == int(mujoco.mjtObj.mjOBJ_GEOM), found[..., 0], -1)
        return np.where(geoms >= 0, self._owners[geoms], -1)

    def close(self) -> None:
        """Give the renderer back."""
        if self._renderer is not None:
            self._renderer.close()

    def _look(self, camera: Floats, shift_m: Floats) -> None:
        if self._renderer is None:
            self._renderer = mujoco.Renderer(self._model, OVER * SIZE[1], OVER * SIZE[0], max_geom=100)
        self._model.light_pos[:] = self._lights + shift_m
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._data.cam_xpos[0] = camera[:3, 3]
        self._data.cam_xmat[0] = (camera[:3, :3] @ _FLIP).ravel()


def lens() -> Floats:
    """fx, fy, cx, cy of what `Stage` draws: pixel centres at integers, as of the camera's own pictures."""
    return np.concatenate((OVER * INTRINSICS[:2], OVER * (INTRINSICS[2:] + 0.5) - 0.5))


def _to_mujoco(pose: Floats) -> Floats:
    turn = np.zeros(4)
    mujoco.mju_mat2Quat(turn, np.ascontiguousarray(pose[:3, :3]).ravel())
    return np.concatenate((pose[:3, 3], turn))


def _xml(bodies: Sequence[Body], setting: Setting) -> str:
    assets, world = [], []
    for at, body in enumerate(bodies):
        vertices, faces = _words(body.rounded.vertices), _words(body.rounded.faces)
        assets.append(f'<texture name="p{at}" type="cube" file="paint{at}.png"/>')
        assets.append(f'<material name="p{at}" texture="p{at}" specular="{setting.shine}" shininess="0.4"/>')
        assets.append(f'<mesh name="b{at}" vertex="{vertices}" face="{faces}" inertia="shell"/>')
        geoms = f'<geom type="mesh" mesh="b{at}" material="p{at}" contype="0" conaffinity="0" mass="0"/>'
        for number, corners in enumerate(body.real.pieces()):
            assets.append(f'<mesh name="b{at}-{number}" vertex="{_words(corners)}"/>')
            geoms += f'<geom type="mesh" mesh="b{at}-{number}" group="4" density="600"/>'
        world.append(f'<body name="b{at}"><freejoint/>{geoms}</body>')
    if setting.finger:
        world.append(f'<body mocap="true"><geom {_FINGER} rgba="0.72 0.52 0.42 1"/></body>')
    for place, bright in setting.lights:
        where, way = _words(place), _words(-place)
        world.append(
            f'<light pos="{where}" dir="{way}" diffuse="{bright} {bright} {bright}" cutoff="40" exponent="0"/>'
        )
    fx, fy, cx, cy = INTRINSICS
    width, height = SIZE
    pixels = f'focalpixel="{fx} {fy}" principalpixel="{width / 2 - 0.5 - cx} {height / 2 - 0.5 - cy}"'
    return f"""<mujoco>
    <option timestep="{STEP_S}" cone="elliptic" impratio="5"/>
    <default><geom friction="0.6 0.005 0.0001" solref="0.004 1"/></default>
    <visual><global offwidth="{OVER * width}" offheight="{OVER * height}"/><map znear="0.02" zfar="20"/>
      <quality shadowsize="{_SHADOWS_PX}" offsamples="0"/>
      <headlight ambient="{setting.ambient} {setting.ambient} {setting.ambient}" diffuse="0 0 0" specular="0 0 0"/>
    </visual>
    <statistic center="0 0 0" extent="1"/>
    <asset><texture type="skybox" builtin="gradient" rgb1=".5 .5 .48" rgb2=".25 .25 .28" width="64" height="384"/>
      <texture name="table" type="2d" file="table.png"/><material name="table" texture="table" specular="0.1"/>
      {"".join(assets)}</asset>
    <worldbody>{"".join(world)}
      <geom type="box" size="{_words(_TABLE_M)}" pos="0 0 {-_TABLE_M[2]}" material="table"/>
      <camera name="eye" resolution="{width} {height}" sensorsize="0.0064 0.0048" {pixels}/>
    </worldbody></mujoco>"""


def _words(numbers: Array | Sequence[float]) -> str:
    return " ".join(f"{number:.9g}" for number in np.ravel(numbers))


def visible_shares(stage: Stage, bodies: Sequence[Body], camera: Floats) -> Floats:
    """Of each body the share of its silhouette that is seen from world_from_camera; outside the picture nothing is."""
    labels, eye = stage.labels(camera), invert(camera)
    whole = [covered(body.real, eye @ pose)[0].sum() for body, pose in zip(bodies, stage.poses, strict=True)]
    seen = [(labels == at).sum() for at in range(len(bodies))]
    return np.clip(np.array(seen) / np.maximum(whole, 1), 0.0, 1.0)


def covered(form: Form, camera_from_body: Floats) -> tuple[Array, Array]:
    """A form's silhouette, by projecting its triangles: bool (h, w), and the column and row where it begins."""
    mesh, (fx, fy, cx, cy) = form.mesh(), lens()
    points = mesh.vertices @ camera_from_body[:3, :3].T + camera_from_body[:3, 3]
    pixels = np.column_stack((fx * points[:, 0], fy * points[:, 1])) / points[:, 2:] + np.array([cx, cy])
    begin = np.floor(pixels.min(axis=0)).astype(int)
    width, height = np.ceil(pixels.max(axis=0)).astype(int) - begin + 1
    x, y = np.meshgrid(begin[0] + np.arange(width), begin[1] + np.arange(height))
    inside = np.zeros((height, width), bool)
    for corners in pixels[mesh.faces]:
        ways = np.roll(corners, -1, axis=0) - corners
        sides = [way[0] * (y - corner[1]) - way[1] * (x - corner[0]) for corner, way in zip(corners, ways, strict=True)]
        inside |= np.min(sides, axis=0) >= 0
        inside |= np.max(sides, axis=0) <= 0
    return inside, begin
