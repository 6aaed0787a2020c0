"""The formal core: nodes, hierarchies and the process model, as pure functions on values."""
