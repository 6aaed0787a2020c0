"""A canvas of Rerun's: things as its archetypes, views as its blueprint."""

from collections.abc import Iterable, Sequence
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from hierax.runtime.core import showing
from hierax.runtime.viewing.presenter import Canvas
from hierax.runtime.viewing.views import Column, Kind, Placed, View

TIMELINE, TIME = "epoch", "time"  # the timelines: the epoch's number, and the world's time in seconds
JPEG_QUALITY = 85  # the quality of pictures, which take a tenth of the room by it
DEPTH_MARGIN = 0.7  # the nearest depth is not drawn as black, which is where nothing is
_IMAGE = "/image"  # where a camera's picture stands, relative to the camera
Parts = Sequence[tuple[str, Any]]  # archetypes, each with where it goes, relative to the thing's path


class _Drawn(NamedTuple):
    """What is shown of a thing."""

    kind: type  # of thing, or of figure
    below: tuple[str, ...]  # where something of it stands, relative to its path
    labelled: bool


class RerunCanvas(Canvas):
    """Draws into a stream of Rerun's, which is joined to a viewer or a file before or after."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._styled: set[str] = set()
        self._meshes: dict[str, showing.Mesh] = {}
        self._drawn: dict[str, _Drawn] = {}  # by path, what is shown there now

    def draw(self, epoch: int, time_s: float, things: Iterable[Placed]) -> None:
        self._set_time(epoch, time_s)
        for each in things:
            self._style(each)
            self._clear_other(each)
            for below, archetype in self._parts(each):
                self._stream.log(_entity(f"{each.path}{below}"), archetype)

    def clear(self, epoch: int, time_s: float, paths: Iterable[str]) -> None:
        self._set_time(epoch, time_s)
        for path in paths:
            self._clear(path)

    def arrange(self, columns: tuple[Column, ...]) -> None:
        self._stream.send_blueprint(blueprint(columns))

    def _clear(self, path: str) -> None:
        self._meshes.pop(path, None)
        drawn = self._drawn.pop(path, None)
        for below in ("",) if drawn is None else drawn.below:
            self._stream.log(_entity(f"{path}{below}"), rr.Clear(recursive=False))

    def _clear_other(self, each: Placed) -> None:
        """Rerun goes on to show what is not said anew: another thing, or labels and pictures that it has no more."""
        drawn = _drawn(each.thing)
        if self._drawn.get(each.path, drawn) != drawn:
            self._clear(each.path)
        self._drawn[each.path] = drawn

    def _set_time(self, epoch: int, time_s: float) -> None:
        self._stream.set_time(TIMELINE, sequence=epoch)
        self._stream.set_time(TIME, duration=time_s)

    def _style(self, each: Placed) -> None:
        """How a curve is drawn is said once."""
        if each.view.kind is not Kind.PLOT or each.path in self._styled:
            return
        self._styled.add(each.path)
        colours = [each.thing.colour] if isinstance(each.thing, showing.Curve) and each.thing.colour else None
        self._stream.log(
            _entity(each.path),
            rr.SeriesLines(names=each.label, colors=colours, widths=1.5),
            # a run of one epoch has points, and no lines
            rr.SeriesPoints(names=each.label, colors=colours, markers="circle", marker_sizes=2.0),
            static=True,
        )

    def _parts(self, each: Placed) -> Parts:
        """What is drawn of a thing; of a mesh whose shape is there already the pose alone."""
        thing = each.thing
        if isinstance(thing, showing.Mesh):
            shape = self._meshes.get(each.path)
            self._meshes[each.path] = thing
            pairs = [] if shape is None else [(shape.vertices, thing.vertices), (shape.faces, thing.faces)]
            same = all(np.array_equal(one, other) for one, other in pairs)
            if shape is not None and shape.colour == thing.colour and same:
                return [("", _transform(thing.pose))]
        return archetypes(thing)


def _drawn(thing: showing.Thing) -> _Drawn:
    if isinstance(thing, Real):
        return _Drawn(float, ("",), False)
    below = ("", _IMAGE) if isinstance(thing, showing.Camera) and thing.image is not None else ("",)
    labels = thing.labels if isinstance(thing, (showing.Points2D, showing.Points3D)) else getattr(thing, "label", "")
    return _Drawn(type(thing), below, bool(labels))


def _entity(path: str) -> str:
    """A path as Rerun writes it, which has spaces and the like escaped."""
    return rr.new_entity_path(path.split("/")).removeprefix("/")


def archetypes(thing: showing.Thing) -> Parts:
    """A thing as Rerun's archetypes."""
    match thing:
        case showing.Curve():
            return [("", rr.Scalars(thing.value))]
        case str():
            return [("", rr.TextDocument(thing, media_type=rr.MediaType.MARKDOWN))]
        case showing.Image():
            return [("", _compressed(thing.pixels))]
        case showing.Depth():
            return [("", _depth(thing))]
        case showing.Labels():
            return _labels(thing)
        case showing.Points2D():
            radius, labels = rr.Radius.ui_points(thing.radius_px), thing.labels or None
            return [("", rr.Points2D(thing.points, colors=thing.colour, radii=radius, labels=labels))]
        case showing.Lines2D():
            radius = rr.Radius.ui_points(thing.width_px / 2)
            return [("", rr.LineStrips2D(np.asarray(thing.lines), colors=thing.colour, radii=radius))]
        case showing.Points3D():
            labels = thing.labels or None
            return [("", rr.Points3D(thing.points, colors=thing.colour, radii=thing.radius_m, labels=labels))]
        case showing.Lines3D():
            return [("", rr.LineStrips3D(np.asarray(thing.lines), colors=thing.colour, radii=thing.radius_m))]
        case showing.Mesh():
            return [("", _transform(thing.pose)), ("", _mesh(thing))]
        case showing.Box():
            mode = rr.components.FillMode.Solid if thing.filled else rr.components.FillMode.MajorWireframe
            half, labels = [np.asarray(thing.size) / 2], [thing.label] if thing.label else None
            box = rr.Boxes3D(half_sizes=half, colors=thing.colour, fill_mode=mode, labels=labels)
            return [("", _transform(thing.pose)), ("", box)]
        case showing.Axes():
            return [("", _transform(thing.pose)), ("", rr.TransformAxes3D(thing.length_m))]
        case showing.Camera():
            image = [] if thing.image is None else [(_IMAGE, _compressed(thing.image))]
            return [("", _transform(thing.pose)), ("", _pinhole(thing)), *image]
        case showing.Graph():
            return _graph(thing)
        case _:
            return [("", rr.Scalars(float(thing)))]


def _depth(thing: showing.Depth) -> rr.DepthImage:
    metres = np.asarray(thing.metres, np.float32)
    known = metres[metres > 0.0]
    span = (DEPTH_MARGIN * float(known.min()), float(known.max())) if known.size else None
    return rr.DepthImage(metres, meter=1.0, colormap="grayscale", depth_range=span)


def _labels(thing: showing.Labels) -> Parts:
    labels = np.asarray(thing.labels)
    names, colours = thing.names or {}, thing.colours or {}
    known = sorted({int(label) for label in np.unique(labels)} | set(names) | set(colours))
    colours = {label: showing.colour_of(label) for label in known} | dict(colours)
    shown = {label: (*colours[label][:3], 255) if label else (0, 0, 0, 0) for label in known}
    classes = [rr.AnnotationInfo(label, names.get(label), colour) for label, colour in shown.items()]
    return [("", rr.AnnotationContext(classes)), ("", rr.SegmentationImage(labels, opacity=thing.opacity))]


def _pinhole(thing: showing.Camera) -> rr.Pinhole:
    fx, fy, cx, cy = np.asarray(thing.intrinsics).tolist()
    return rr.Pinhole(
        focal_length=(fx, fy),
        principal_point=(cx + 0.5, cy + 0.5),  # Rerun's pixels have their centres at halves
        resolution=thing.size,
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=thing.depth_m,
    )


def _graph(thing: showing.Graph) -> Parts:
    colours = thing.colours or {}
    nodes = rr.GraphNodes(
        list(thing.nodes),
        labels=list(thing.nodes.values()),
        positions=None if thing.places is None else [thing.places[name] for name in thing.nodes],
        colors=[colours.get(name, showing.colour_of(2)) for name in thing.nodes],
    )
    edges = rr.GraphEdges(list(thing.edges), graph_type="directed" if thing.directed else "undirected")
    return [("", nodes), ("", edges)]


def blueprint(columns: Sequence[Column]) -> rrb.Blueprint:
    """The columns, side by side."""
    contents = [rrb.Vertical(*(_cell(cell) for cell in column.cells)) for column in columns]
    return rrb.Blueprint(
        rrb.Horizontal(*contents, column_shares=[column.share for column in columns]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


_VIEWS = {
    Kind.PICTURE: rrb.Spatial2DView,
    Kind.SCENE: rrb.Spatial3DView,
    Kind.TEXT: rrb.TextDocumentView,
    Kind.GRAPH: rrb.GraphView,
    Kind.PLOT: rrb.TimeSeriesView,
}


def _cell(views: Sequence[View]) -> Any:
    cells = [_VIEWS[view.kind](origin=f"/{_entity(view.name)}", name=view.name.replace("/", " · ")) for view in views]
    return cells[0] if len(cells) == 1 else rrb.Tabs(*cells)


def _transform(pose: Any) -> rr.Transform3D:
    pose = np.asarray(pose)
    return rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3])


def _mesh(thing: showing.Mesh) -> rr.Mesh3D:
    """Each triangle by itself, so that its normal is its own and edges are seen."""
    corners = np.asarray(thing.vertices)[np.asarray(thing.faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
    return rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3),
        vertex_normals=np.repeat(normals, 3, axis=0),
        albedo_factor=thing.colour,
    )


def _compressed(pixels: Any) -> Any:
    image: showing.Array = np.ascontiguousarray(pixels)
    return rr.Image(image).compress(jpeg_quality=JPEG_QUALITY)
