"""hierax as a Python library: hierarchies built from classes and functions, and runs that a script goes through."""
