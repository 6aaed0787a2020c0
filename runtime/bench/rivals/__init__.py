"""The chain of `hierax bench peers` in what users would pick instead, each as its documentation says it is quickest.

Each module is a program, run by the Python of a virtual environment that has the rival (`make peers`). It starts three
processes: a world that sends a count and a level up, an arm that passes both on, and a spatial node that answers, with
a picture if one is wanted. The arm looks at the picture and passes the level down. It prints how long the world's
epochs took, in microseconds, as JSON. In all of them the picture is bytes that are there before the first epoch."""
