"""THE or CAT: letters whose reading depends on the word that they stand in.

What works on pictures is in `hierax.nodes.letters.pixels`, which needs OpenCV."""

from hierax.nodes.letters.tree import (
    ImpossibleEvidenceError,
    LetterEvidence,
    LetterNode,
    SymbolWorld,
    WordNode,
    WordSupport,
    symbol_seen,
)

__all__ = [
    "ImpossibleEvidenceError",
    "LetterEvidence",
    "LetterNode",
    "SymbolWorld",
    "WordNode",
    "WordSupport",
    "symbol_seen",
]
