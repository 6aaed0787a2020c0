"""What tests share; pytest puts `tests` on the path, so: ``from support.hierarchies import …``."""
