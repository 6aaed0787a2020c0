"""Causal trees and polytrees: exact belief propagation, in one process or as a live hierarchy.

See ``docs/causal-trees.md``."""

from hierax.nodes.causal_tree.errors import EvidenceError, ImpossibleEvidence, NetworkError
from hierax.nodes.causal_tree.hierarchy import EvidenceWorld, as_deployment, evidence_seen
from hierax.nodes.causal_tree.inference import Evidence, Inference, posteriors
from hierax.nodes.causal_tree.network import Description, Network, Variable, epochs_needed, parse
from hierax.nodes.causal_tree.networks import likelihoods, network_from, random_tree, read_network
from hierax.nodes.causal_tree.part import Part, causal_support, diagnostic_support

__all__ = [
    "Description",
    "Evidence",
    "EvidenceError",
    "EvidenceWorld",
    "ImpossibleEvidence",
    "Inference",
    "Network",
    "NetworkError",
    "Part",
    "Variable",
    "as_deployment",
    "causal_support",
    "diagnostic_support",
    "epochs_needed",
    "evidence_seen",
    "likelihoods",
    "network_from",
    "parse",
    "posteriors",
    "random_tree",
    "read_network",
]
