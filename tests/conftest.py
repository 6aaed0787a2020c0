"""For all tests: how workers share them, and where launches leave their logs."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

# Nothing is judged by how long it takes: machines are shared.
settings.register_profile("hierax", deadline=None, print_blob=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("hierax")

# What is started behind a shell's & or nohup ignores these, and so would all processes that tests start and signal.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Where nothing compiled may be kept, each of the hundreds of processes that tests start compiles all modules again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# What follows holds for the workers and for what they start. Memory that is given back to the system is cleared before
# it comes again, image by image; BLAS's threads spin for a while, in each process, before they sleep.
os.environ.setdefault("MALLOC_MMAP_THRESHOLD_", str(32 << 20))
os.environ.setdefault("MALLOC_TRIM_THRESHOLD_", str(512 << 20))
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")

STARTING = {
    "tests/benchmarks/": 1,
    "tests/docs/": 1,
    "tests/nodes/benchmarks/": 1,
    "tests/nodes/causal_tree/": 1,
    "tests/nodes/commands/": 1,
    "tests/nodes/picking/": 1,
    "tests/nodes/ros2/test_by_rclpy.py": 1,
    "tests/nodes/ros2/test_launched.py": 0,
    "tests/nodes/sources/test_live_launched.py": 0,
    "tests/nodes/tower/test_counterfactual.py": 1,
    "tests/nodes/tower/test_seen.py": 1,
    "tests/nodes/tower/test_tower.py": 1,
    "tests/runtime/bench/": 1,
    "tests/runtime/commands/": 0,
    "tests/runtime/core/test_digest.py": 1,
    "tests/runtime/host/test_streams_processes.py": 1,
    "tests/runtime/host/test_streams.py": 1,
    "tests/runtime/launch/test_changes.py": 1,
    "tests/runtime/launch/test_folders.py": 1,
    "tests/runtime/launch/": 0,
    "tests/runtime/loading/test_loader.py": 1,
    "tests/runtime/recording/": 1,
    "tests/runtime/recovery/": 0,
    "tests/runtime/scripting/test_runs.py": 1,
    "tests/runtime/testing/": 1,
    "tests/runtime/tools/": 1,
    "tests/runtime/transport/": 0,
    "tests/runtime/viewing/": 1,
    "tests/runtime/watch/": 1,
    "tests/test_docs_testing.py": 1,
    "tests/test_readme.py": 1,
}
"""Tests that start processes, and which worker has them, one by one: more at once would starve each other. Both wait
for half of their time; what only computes is done meanwhile by a third one."""

SLOW = (
    "tests/model/",
    "tests/nodes/ros2/test_export.py",
    "tests/nodes/ros2/test_live.py",
    "tests/nodes/sources/test_boards.py",
    "tests/nodes/sources/test_live.py",
    "tests/nodes/tower/test_skills.py",
    "tests/nodes/tracking/datasets/test_tag.py",
    "tests/nodes/tracking/estimation/",
    "tests/nodes/tracking/generator/",
    "tests/nodes/tracking/paper/",
    "tests/nodes/tracking/search/",
    "tests/nodes/tracking/simworld/test_raster.py",
    "tests/nodes/tracking/test_arm.py",
    "tests/nodes/tracking/test_world.py",
    "tests/nodes/tracking/test_world_camera.py",
    "tests/runtime/core/test_lemma.py",
    "tests/runtime/core/test_unrolled.py",
    "tests/runtime/deployment/test_read.py",
    "tests/runtime/engine/test_agrees_with_core.py",
    "tests/runtime/engine/test_rated.py",
    "tests/runtime/engine/test_stale.py",
    "tests/runtime/execution/test_free.py",
    "tests/runtime/execution/test_growth.py",
    "tests/runtime/sim/",
    "tests/schemas/test_hostile_bytes.py",
)
"""Tests that only compute, for seconds."""

LONG = (
    "tests/docs/test_docs.py::test_the_commands_of_a_page_work",
    "tests/docs/test_docs.py::test_the_tutorial_works_with_what_its_reader_has",
    "tests/nodes/ros2/test_launched.py::test_it_publishes_and_survives_and_is_repeated",
    "tests/nodes/sources/test_live_launched.py::test_a_stream_that_stalls_and_breaks_off_is_recovered_and_repeated",
    "tests/nodes/sources/test_live_launched.py::test_processes_that_are_killed_see_no_frame_twice",
    "tests/nodes/test_servo.py",
    "tests/nodes/tower/test_counterfactual.py",
    "tests/nodes/tower/test_person.py::test_several_happen_one_after_the_other",
    "tests/nodes/tower/test_person.py::test_two_cubes_change_places_while_the_camera_does_not_see_one",
    "tests/nodes/tower/test_seen.py",
    "tests/nodes/tower/test_skills.py::test_no_tower_is_taken_down_for_what_is_out_of_reach_anyhow",
    "tests/nodes/tracking/datasets/test_junk_scenes.py",
    "tests/nodes/tracking/datasets/test_tag.py::test_a_scene_without_camera_poses_is_tracked_by_its_tag_as_with_them",
    "tests/nodes/tracking/datasets/test_tag.py::test_with_a_tag_an_object_is_found_where_neither_camera_nor_poses",
    "tests/nodes/tracking/estimation/test_joint_alignment.py::test_an_open_box_stays_while_a_side_turns_away",
    "tests/nodes/tracking/generator/test_scenes.py",
    "tests/nodes/tracking/test_search.py::test_what_is_taken_out_is_said_to_be_gone",
    "tests/runtime/commands/test_malicious_files.py",
    "tests/runtime/engine/test_rated.py::test_processes_that_die_change_nothing",
    "tests/runtime/launch/test_closed.py",
    "tests/runtime/launch/test_encrypted.py::test_who_shows_no_certificate_of_the_run_is_let_in_at_no_port_and_told",
    "tests/runtime/launch/test_far_hosts.py::test_a_link_that_is_cut_and_healed_holds_the_epoch_and_nothing_else",
    "tests/runtime/launch/test_far_hosts.py::test_certificates_are_renewed_on_all_hosts",
    "tests/runtime/launch/test_hosts.py",
    "tests/runtime/launch/test_links.py::test_epochs_go_on_by_themselves_after_stops",
    "tests/runtime/launch/test_pictures.py::test_a_recording_that_begins_in_the_middle_has_all_pictures",
    "tests/runtime/launch/test_rated.py::test_a_world_that_waits_for_nobody_comes_up_and_hears",
    "tests/runtime/launch/test_rated.py::test_what_a_process_that_was_killed_has_waited_for_is_told",
    "tests/runtime/launch/test_rates.py::test_the_backlog_of_a_world_that_stood_still_has_a_line",
    "tests/runtime/launch/test_renewal.py",
    "tests/runtime/launch/test_roles.py",
    "tests/runtime/recording/test_live.py::test_a_recording_of_a_launch_ends_where_it_is_told_to",
    "tests/runtime/sim/test_simulation.py::test_nothing_is_wrong_under_faults_of_one_kind",
    "tests/runtime/sim/test_simulation.py::test_nothing_is_wrong_with_rates_and_delays",
    "tests/runtime/viewing/test_picture.py",
    "tests/schemas/test_hostile_bytes.py::test_attacks_cost_no_more_memory_than_they_may",
    "tests/schemas/test_hostile_bytes.py::test_many_small_entries_are_bounded_in_number",
)
"""A third of what all tests take, in some dozens of them."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """How `make test` divides the tests among its workers."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            starting = [worker for path, worker in STARTING.items() if nodeid.startswith(path)]
            return f"starting {starting[0]}" if starting else nodeid.partition("::")[0]

    return ByFile(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """`make test-quick` leaves out what starts processes, and what is slow; `make test` what is long."""
    for item in items:
        if item.nodeid.startswith(LONG):
            item.add_marker("long")
        if item.nodeid.startswith(tuple(STARTING)):
            item.add_marker("processes")
        elif item.nodeid.startswith(SLOW):
            item.add_marker("slow")


@pytest.fixture(scope="session", autouse=True)
def _logs_elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Logs of this worker's launches, and where they are found, are its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(os.environ, "XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("running")))
        patch.setitem(os.environ, "XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield
