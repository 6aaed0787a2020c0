"""Processes wait for who records a run, or is about to, and for nobody who has gone."""

from __future__ import annotations

from hierax.runtime.launch.recorders import COMES_S, Recorders


def test_who_is_about_to_record_is_waited_for_and_not_for_ever() -> None:
    now_s = 0.0
    recorders = Recorders(lambda: now_s)
    assert not recorders.are_there
    recorders.expect()
    assert recorders.are_there
    now_s = COMES_S
    assert not recorders.are_there, "it has not come"


def test_who_has_recorded_and_is_gone_is_not_waited_for() -> None:
    now_s = 0.0
    recorders = Recorders(lambda: now_s)
    recorders.expect()
    recorders.hear_of(True)
    now_s = 10 * COMES_S
    assert recorders.are_there, "it records"
    recorders.hear_of(False)
    assert not recorders.are_there
    now_s = 0.0
    assert not recorders.are_there, "who was expected has come, and gone"
