from __future__ import annotations

from hierax.runtime.viewing.views import EPOCHS, HIERARCHY, Kind, Layout, View, arranged, default_layout, unknown_names

KINDS = {
    "camera": Kind.PICTURE,
    "scene": Kind.SCENE,
    "errors": Kind.PLOT,
    "arm/scores": Kind.PLOT,
    "arm/belief": Kind.TEXT,
    HIERARCHY: Kind.GRAPH,
    EPOCHS: Kind.PLOT,
}
VIEWS = {name: View(name, kind) for name, kind in KINDS.items()}


def names(layout: Layout | None) -> list[list[list[str]]]:
    return [[[view.name for view in cell] for cell in column.cells] for column in arranged(VIEWS, layout)]


def test_without_a_layout_views_stand_by_what_they_hold() -> None:
    assert names(None) == [
        [["camera"]],
        [["scene"]],
        [["errors"], ["arm/scores"]],
        [[HIERARCHY], ["arm/belief"], [EPOCHS]],
    ]


def test_pictures_and_scenes_are_wider() -> None:
    assert [column.share for column in arranged(VIEWS, None)] == [3.0, 3.0, 2.0, 2.0]


def test_many_views_share_the_last_cell() -> None:
    many = [View(f"node/{number}", Kind.PLOT) for number in range(5)]
    assert default_layout(many)[0] == (("node/0",), ("node/1",), ("node/2", "node/3", "node/4"))


def test_what_a_layout_does_not_name_comes_at_the_end() -> None:
    layout: Layout = ((("camera",), ("errors", "arm/scores")), (("scene",),))
    assert names(layout) == [
        [["camera"], ["errors", "arm/scores"]],
        [["scene"], ["arm/belief", HIERARCHY, EPOCHS]],
    ]


def test_names_that_nothing_has_are_left_out_and_told() -> None:
    layout: Layout = ((("camra",),), (("scene", "skene"),))
    assert names(layout)[0][0] == ["scene"]
    assert unknown_names(VIEWS, layout) == ("camra", "skene")
    assert names((("nothing",),))[0] == [list(KINDS)]  # type: ignore[arg-type]
