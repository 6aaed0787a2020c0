"""Deployment files: reading them, and what they say. `read` has the reader; it alone needs pydantic."""

from hierax.runtime.deployment.deployment import Deployment, DeploymentError

__all__ = ["Deployment", "DeploymentError"]
