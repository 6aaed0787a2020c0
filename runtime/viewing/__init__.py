"""Seeing what nodes believe: from what they say that they show to a viewer, and how it is laid out.

`ViewPresenter` takes the nodes' steps and puts what is to be shown on a `Canvas`. Only `rerun_canvas` and `viewer` know
Rerun."""
