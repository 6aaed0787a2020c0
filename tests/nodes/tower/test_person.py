"""What somebody does to towers: each interference happens as it says, by the truth, and the picture shows a hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hierax.nodes.picking.commands import command
from hierax.nodes.picking.panda import HOME_GRIPPER, WIDEST_M, gripper_down
from hierax.nodes.picking.world import picture_and_hand_seen
from hierax.nodes.tower.interferences import ACTS, FAST_M_S, HOME_M, Stop, is_due
from hierax.nodes.tower.person import NOBODY, acted, drawn_for
from hierax.nodes.tower.person import moved as after_frame
from hierax.nodes.tower.world import TowerWorld
from hierax.runtime.core.node import Tick
from hierax.schemas.values import decode_value, encode_value

pytestmark = pytest.mark.slow

TOWER = [1, 3, 4, 2]
FRAMES = 450
REST = (command(HOME_GRIPPER, WIDEST_M, 0.25),)
SEED, OTHER_SEED = 9, 10  # these draw that something is due as soon as it can be
LATE_SEED = 1


def begun(person: Any) -> tuple[TowerWorld, Any]:
    """A world in which the third cube stands on the first, and the next one is the fourth; nothing is hidden."""
    world = TowerWorld(TOWER, person, cubes=4)
    belief = world.initial_belief()
    bodies = {body["id"]: body for body in belief["bodies"]}
    on = bodies[1]["pose"].copy()
    on[2, 3] += (bodies[1]["side_m"] + bodies[3]["side_m"]) / 2
    return world, {
        **belief,
        "bodies": tuple({**body, "pose": on} if body["id"] == 3 else body for body in belief["bodies"]),
    }


def until_done(world: TowerWorld, belief: Any, seed: int = SEED) -> list[Any]:
    """Beliefs, frame by frame, until the person has gone; the arm rests."""
    beliefs = [belief]
    while not beliefs[-1]["person"]["over"]:
        assert len(beliefs) < FRAMES, beliefs[-1]["person"]
        beliefs.append(world.predict((), REST, beliefs[-1], Tick(seed=seed)))
    for _ in range(10):
        beliefs.append(world.predict((), REST, beliefs[-1], Tick(seed=seed)))
    return beliefs


def moves_m(beliefs: list[Any]) -> dict[int, Any]:
    """By how much each cube is elsewhere at the end."""
    first, last = ({body["id"]: body["pose"][:3, 3] for body in beliefs[at]["bodies"]} for at in (0, -1))
    return {number: last[number] - first[number] for number in first}


def stays(shift: Any) -> bool:
    return bool(np.linalg.norm(shift) < 0.003)


def knocked(by: dict[int, Any]) -> bool:
    return by[3][2] < -0.04 and all(map(stays, (by[2], by[4])))


def moved(by: dict[int, Any]) -> bool:
    return np.linalg.norm(by[4][:2]) > 0.03 and abs(by[4][2]) < 0.002 and all(map(stays, (by[1], by[2], by[3])))


def helped(by: dict[int, Any]) -> bool:
    return by[4][2] > 0.09 and all(map(stays, (by[1], by[2], by[3])))


def covered(by: dict[int, Any]) -> bool:
    return by[2][2] > 0.04 and all(map(stays, (by[1], by[3], by[4])))


def pushed(by: dict[int, Any]) -> bool:
    return 0.04 < abs(by[1][1]) < 0.06 and abs(by[3][2]) < 0.002 and all(map(stays, (by[2], by[4])))


@pytest.mark.parametrize(
    ("name", "happened"),
    [("knock", knocked), ("move", moved), ("help", helped), ("cover", covered), ("push", pushed)],
)
def test_it_happens_as_it_says(name: str, happened: Callable[[dict[int, Any]], bool]) -> None:
    world, belief = begun(name)
    beliefs = until_done(world, belief)
    assert happened(moves_m(beliefs)), (name, moves_m(beliefs))
    assert world.metrics(beliefs[-1])["interferences"] == 1.0
    assert beliefs[-1]["obstacles"] == ()
    hands = [each["person"]["hand"][:3, 3] for each in beliefs if each["obstacles"]]
    assert np.linalg.norm(np.diff(hands, axis=0), axis=1).max() < 0.05  # nothing jumps
    cubes = [np.stack([body["pose"][:3, 3] for body in each["bodies"]]) for each in beliefs]
    assert np.linalg.norm(np.diff(cubes, axis=0), axis=2).max() < 0.06


def test_two_cubes_change_places_while_the_camera_does_not_see_one() -> None:
    world, belief = begun("swap")
    assert not world.predict((), REST, belief, Tick(seed=SEED))["person"]["stops"]
    near = belief["bodies"][0]["pose"].copy()
    near[:3, :3], near[2, 3] = HOME_GRIPPER[:3, :3], 0.2
    looks = (command(near, WIDEST_M, 0.5),)
    beliefs = [belief]
    while not beliefs[-1]["person"]["over"]:
        assert len(beliefs) < FRAMES, beliefs[-1]["person"]
        beliefs.append(world.predict((), looks, beliefs[-1], Tick(seed=SEED)))
    first, last = ({body["id"]: body["pose"][:2, 3] for body in beliefs[at]["bodies"]} for at in (0, -1))
    assert np.linalg.norm(first[2] - last[4]) < 0.01
    assert np.linalg.norm(first[4] - last[2]) < 0.01


def test_those_change_places_from_which_the_gripper_is_away() -> None:
    world = TowerWorld(TOWER, "swap", cubes=4)
    scene = world._seen(world.initial_belief(), 0)(0)
    flat = [number for number in scene.idle if number not in scene.standing]
    first, *others = flat
    near = scene._replace(hidden=frozenset({others[-1]}), gripper=scene.bodies[first]["pose"][:3, 3])
    stops = ACTS["swap"](near)
    assert stops is not None
    assert {stop.grip for stop in stops} - {0} == set(others)
    assert ACTS["swap"](near._replace(hidden=frozenset({first}))) is None


def test_the_cube_in_the_arms_hand_is_taken_out_of_it_and_laid_down() -> None:
    world = TowerWorld(TOWER, "take", cubes=4)
    belief = world.initial_belief()
    cube = belief["bodies"][3]
    down = gripper_down(cube["pose"][:3, 3], float(np.arctan2(cube["pose"][1, 0], cube["pose"][0, 0])))
    up = down.copy()
    up[2, 3] = 0.25
    for goal, width, frames in ((up, 0.08, 60), (down, 0.08, 60), (down, 0.0, 20)):
        for _ in range(frames):
            belief = world.predict((), (command(goal, width, 0.25),), belief, Tick(seed=SEED))
    assert not belief["person"]["stops"]
    heights = []
    while not belief["person"]["over"]:
        assert len(heights) < FRAMES, belief["person"]
        belief = world.predict((), (command(up, 0.0, 0.25),), belief, Tick(seed=SEED))
        heights.append(belief["bodies"][3]["pose"][2, 3])
    assert max(heights) > 0.10
    assert belief["actions"] == 1
    assert abs(heights[-1] - cube["side_m"] / 2) < 0.002
    assert np.linalg.norm(belief["bodies"][3]["pose"][:2, 3] - cube["pose"][:2, 3]) > 0.03
    assert belief["fingers"].sum() < 0.01


def test_a_hand_draws_back_where_the_gripper_comes_and_tries_again() -> None:
    world, belief = begun("move")
    cube = belief["bodies"][3]["pose"]
    near = gripper_down(cube[:3, 3] + (0.0, 0.0, 0.10))
    while not belief["person"]["stops"]:
        belief = world.predict((), REST, belief, Tick(seed=SEED))
    for _ in range(90):
        belief = world.predict((), (command(near, WIDEST_M, 2.0),), belief, Tick(seed=SEED))
    assert not belief["person"]["stops"]
    assert belief["person"]["over"] == ()
    assert np.linalg.norm(belief["bodies"][3]["pose"][:3, 3] - cube[:3, 3]) < 0.003
    assert moved(moves_m(until_done(world, belief)))


def test_what_is_tried_again_happens_once() -> None:
    home = NOBODY["hand"]
    ends = [Stop(HOME_M)._replace(counts=counts)._asdict() for counts in (False, True)]
    tried = {**NOBODY, "touched": True, "act": 1, "stops": (ends[0],), "late_s": 9.0}
    done = {"stops": (ends[1],), "late_s": 9.0}
    back = after_frame(tried, home, np.zeros(6))
    assert (back["over"], back["happened"]) == ((), 0)
    over = after_frame({**back, **done, "act": 1}, home, np.zeros(6))
    assert (over["over"], over["happened"]) == ((1,), 1)
    again = after_frame({**over, **done, "act": 0}, home, np.zeros(6))
    assert (again["over"], again["happened"]) == ((1, 0), 1)


def test_a_hand_lets_the_gripper_pass_but_not_for_ever() -> None:
    world, belief = begun("move")
    while belief["person"]["holds"] is None or belief["bodies"][3]["pose"][2, 3] < 0.08:
        belief = world.predict((), REST, belief, Tick(seed=SEED))
    person, scene = belief["person"], world._seen(belief, SEED)(0)
    way = person["stops"][0]["to"] - person["target"][:3, 3]
    way *= 0.1 / np.linalg.norm(way)

    def steps(gripper: Any, count: int) -> list[float]:
        """How far the hand is drawn in each of so many frames."""
        after, found = person, []
        for _ in range(count):
            before = after["target"]
            after, _ = acted(after, lambda _: scene._replace(gripper=gripper), ["move"], 0.05)
            found.append(float(np.linalg.norm((after["target"] - before)[:3, 3])))
        return found

    assert steps(person["target"][:3, 3] + way, 80) == [0.0] * 80
    assert steps(person["target"][:3, 3] + way, 82)[-1] > 0.005
    assert steps(person["target"][:3, 3] - way, 1)[0] > 0.005


def test_a_hand_that_comes_free_flings_nothing() -> None:
    """It was held up, with a cube in it, until it should have been far ahead; before, nothing slowed it down."""
    world, belief = begun("move")
    beliefs = [belief]
    while belief["person"]["holds"] is None or belief["bodies"][3]["pose"][2, 3] < 0.08:
        assert len(beliefs) < FRAMES
        belief = world.predict((), REST, belief, Tick(seed=SEED))
        beliefs.append(belief)
    ways = np.diff([each["person"]["hand"][:3, 3] for each in beliefs if each["obstacles"]], axis=0)
    assert np.linalg.norm(ways[2:8], axis=1) == pytest.approx(np.full(6, FAST_M_S / 20), abs=0.0005)
    ahead = belief["person"]["target"].copy()
    ahead[:3, 3] += (0.0, -0.25, 0.20)
    beliefs = until_done(world, {**belief, "person": {**belief["person"], "target": ahead}})
    hands = [each["person"]["hand"][:3, 3] for each in beliefs if each["obstacles"]]
    assert np.linalg.norm(np.diff(hands, axis=0), axis=1).max() < 0.1
    assert beliefs[-1]["bodies"][3]["pose"][2, 3] < 0.03  # on the table


def test_several_happen_one_after_the_other() -> None:
    """A cube that is removed is out of the camera's sight for seconds, and comes back elsewhere."""
    world, belief = begun(["push", "none", "remove"])
    beliefs = until_done(world, belief, OTHER_SEED)
    while len(beliefs[-1]["person"]["over"]) < 2:
        assert len(beliefs) < 2 * FRAMES
        beliefs.append(world.predict((), REST, beliefs[-1], Tick(seed=OTHER_SEED)))
    assert world.metrics(beliefs[-1])["interferences"] == 2.0
    removed = [each["bodies"][3]["pose"][:3, 3] for each in beliefs]
    assert sum(place[0] > 0.8 for place in removed) > 4.0 * 20
    assert 0.03 < np.linalg.norm(removed[-1][:2] - removed[0][:2]) < 0.4


def test_what_cannot_begin_keeps_nothing_else_from_it() -> None:
    """The camera sees all cubes, so none are swapped; and the run does not end while one may be covered yet."""
    world, belief = begun(["swap", "cover"])
    assert not world.finished({**belief, "done_s": 9.0})
    beliefs = until_done(world, belief, SEED)
    assert beliefs[-1]["person"]["over"] == (1,)
    assert covered(moves_m(beliefs))
    assert world.finished({**beliefs[-1], "done_s": 9.0}), "nothing is left that could begin"


def test_a_cube_is_hidden_out_of_the_picture_or_behind_another_one() -> None:
    world, belief = begun("swap")
    assert world._seen(belief, SEED)(0).hidden == frozenset()
    bodies = {body["id"]: body for body in belief["bodies"]}
    eye, middle = belief["camera"][:3, 3], bodies[2]["pose"][:3, 3]

    def hidden(place: Any) -> frozenset[int]:
        """Which are, with the fourth cube in a place."""
        pose = np.eye(4)
        pose[:3, 3] = place
        others = tuple({**body, "pose": pose} if body["id"] == 4 else body for body in belief["bodies"])
        return world._seen({**belief, "bodies": others}, SEED)(0).hidden

    assert hidden(middle + 0.3 * (eye - middle)) == {2}, "it hides the second one"
    assert hidden(middle - 0.3 * (eye - middle)) == {4}, "the second one hides it"
    assert hidden(eye + 0.3 * (eye - middle)) == {4}, "it is behind the camera"


def test_a_tower_is_knocked_over_from_any_of_its_cubes_on_but_the_lowest() -> None:
    world, belief = begun("knock")
    scene = world._seen(belief, SEED)(0)._replace(standing=(1, 3, 4))
    heights = {body["pose"][2, 3]: number for number, body in scene.bodies.items() if number != 2}
    levels = set()
    for seed in range(20):
        stops = ACTS["knock"](scene._replace(rng=np.random.default_rng(seed)))
        assert stops is not None
        levels.add(min(heights.items(), key=lambda item: abs(item[0] - stops[1].to[2]))[1])
    assert levels == {3, 4}


def test_the_seed_says_when_and_states_go_over_the_wire() -> None:
    """A world that goes on from what was sent does the same, to the bit; another seed begins at another instant."""
    ends = []
    for seed in (SEED, SEED, OTHER_SEED):
        world, belief = begun("move")
        for frame in range(100):
            if frame % 7 == 0:
                belief = decode_value(encode_value(belief))
                world = TowerWorld(TOWER, "move", cubes=4)
            belief = world.predict((), REST, belief, Tick(seed=seed))
        ends.append(encode_value(belief))
    assert ends[0] == ends[1] != ends[2]


@pytest.mark.parametrize(
    ("name", "heights"),
    [
        *((name, {2, 3, 4}) for name in ("knock", "push")),
        *((name, {1, 2, 3}) for name in ("move", "take", "help", "remove")),
        ("cover", {1, 2}),
        ("swap", {1}),
    ],
)
def test_each_height_at_which_something_can_be_done_is_drawn_as_often(name: str, heights: set[int]) -> None:
    world, belief = begun(name)
    scene = world._seen(belief, SEED)(0)
    low, high = min(heights), max(heights)

    def due(drawn: float) -> int:
        """From how many cubes on it is due."""
        standing = [scene._replace(standing=tuple(TOWER[:count]), drawn=drawn) for count in range(len(TOWER) + 1)]
        return [is_due(name, each) for each in standing].index(True)

    assert [due(drawn) for drawn in (0.0, 0.999)] == [low, high]
    found = [due((at + 0.5) / 60) for at in range(60)]
    assert {height: found.count(height) for height in found} == dict.fromkeys(heights, 60 // len(heights))


def test_a_short_tower_is_knocked_over_as_soon_as_it_stands() -> None:
    world, belief = begun("knock")
    scene = world._seen(belief, SEED)(0)._replace(whole=2, drawn=0.999)
    assert is_due("knock", scene._replace(standing=(1, 3)))
    assert not is_due("knock", scene._replace(standing=(1,)))


def test_what_is_due_later_waits_until_the_tower_is_so_high() -> None:
    """With the third cube on the first, the fourth is moved at once; by another seed the tower has to be higher."""
    assert drawn_for(LATE_SEED, 0, 0, 1).height > 2 / 3 > drawn_for(SEED, 0, 0, 1).height
    for seed, begins in ((SEED, True), (LATE_SEED, False)):
        world, belief = begun("move")
        for _ in range(60):
            belief = world.predict((), REST, belief, Tick(seed=seed))
        assert bool(belief["person"]["stops"]) == begins


def test_of_several_the_first_is_due_while_the_tower_is_low_and_the_last_when_it_is_high() -> None:
    for seed in range(20):
        drawn = [drawn_for(seed, 0, number, 3).height for number in range(3)]
        assert [int(3 * each) for each in drawn] == [0, 1, 2]


def test_the_camera_sees_a_hand() -> None:
    world, belief = begun("cover")
    pictures = []
    for _ in range(120):
        belief = world.predict((), REST, belief, Tick(seed=SEED))
        if belief["person"]["holds"] is not None:
            pictures = [
                picture_and_hand_seen({**belief, "obstacles": shown, "noise": 0.0})[0]["image"].astype(int)
                for shown in (belief["obstacles"], ())
            ]
            break
    differs = np.abs(pictures[0] - pictures[1]).sum(axis=2) > 60
    assert differs.mean() > 0.01


def test_nothing_is_done_to_what_is_not_there() -> None:
    """Of no tower two cubes stand, and the arm holds nothing."""
    for name in ("knock", "push", "take"):
        world = TowerWorld(TOWER, name, cubes=4)
        belief = world.initial_belief()
        for _ in range(70):
            belief = world.predict((), REST, belief, Tick(seed=SEED))
        assert world.metrics(belief)["interferences"] == 0.0, name
        assert belief["obstacles"] == ()


@pytest.mark.parametrize("person", ["kick", ["knock", "kick"], 3, None, {"knock": None}, [3]])
def test_who_does_what_nobody_knows_is_refused(person: Any) -> None:
    with pytest.raises(ValueError, match=r"person is .*; expected none, or one of knock, move, .*, or a list of such"):
        TowerWorld(TOWER, person)


def test_a_hand_that_finds_nothing_to_grip_has_not_interfered() -> None:
    """The cube is taken away while the hand comes."""
    world, belief = begun("move")
    while not belief["person"]["stops"]:
        belief = world.predict((), REST, belief, Tick(seed=SEED))
    gone = belief["bodies"][3]["pose"].copy()
    gone[:2, 3] = (0.45, 0.35)
    bodies = tuple({**body, "pose": gone} if body["id"] == 4 else body for body in belief["bodies"])
    last = until_done(world, {**belief, "bodies": bodies})[-1]
    assert (last["person"]["over"], world.metrics(last)["interferences"]) == ((0,), 0.0)


def test_a_removed_cube_comes_back_to_where_there_is_room_by_then() -> None:
    """What is put down where it would have come, while it is away, is not touched."""
    world, belief = begun("remove")
    free = until_done(world, belief)[-1]["bodies"][3]["pose"]
    beliefs = [belief]
    while beliefs[-1]["bodies"][3]["pose"][0, 3] < 0.8:
        beliefs.append(world.predict((), REST, beliefs[-1], Tick(seed=SEED)))
    there = free.copy()
    there[2, 3] = beliefs[-1]["bodies"][1]["side_m"] / 2
    placed = tuple({**body, "pose": there} if body["id"] == 2 else body for body in beliefs[-1]["bodies"])
    last = until_done(world, {**beliefs[-1], "bodies": placed})[-1]["bodies"]
    assert stays(last[1]["pose"][:3, 3] - there[:3, 3])
    assert last[3]["pose"][2, 3] < 0.03
    assert np.linalg.norm(last[3]["pose"][:2, 3] - there[:2, 3]) > 0.05
