"""Recordings: what is recorded, how it is read, replayed, compared and checked.

`Recording` is all that it takes to read one:

    recording = Recording.open(path)
    recording.info                      # hierarchy, seed, deployment file, machine, ...
    for epoch in recording.epochs():    # committed ones, with rosters, states, messages and digests
        ...
"""
