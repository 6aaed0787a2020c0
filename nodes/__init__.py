"""Nodes that come with hierax: letters, visual servoing, tracking."""
