"""Seeing what nodes believe: from what they say that they show to a viewer, and how it is laid out.

`ViewPresenter` takes the nodes' steps and puts what is to be shown on a `Canvas`. Only
`hierax.runtime.viewing.rerun_canvas` and `hierax.runtime.viewing.viewer` know Rerun.
"""
