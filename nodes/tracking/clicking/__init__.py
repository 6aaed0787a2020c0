"""First poses by a user who clicks corners in a scene's first picture: ``hierax init``."""
