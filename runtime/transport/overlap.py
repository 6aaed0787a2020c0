"""What is heard in two sessions of a recorder, one after the other, while both listen: each sample counts once."""

from collections import Counter, deque
from hashlib import blake2b

from hierax.runtime.transport.port import Sample

_HASH_BYTES = 16

_Mark = tuple[str, bytes]  # a key, and what stands for the bytes


class Overlap:
    """Both sessions hear the same samples, though not at the same time. While both listen, those of the one `before`
    count. What the `next` one hears waits until the other has heard it, too; what the other never hears, as it is
    closed, is told by `rest`, in the order in which the next one has heard it: of each who says something that is its
    last words."""

    def __init__(self) -> None:
        self._heard: Counter[_Mark] = Counter()  # before, and not yet in the next one
        self._ahead: dict[_Mark, deque[tuple[int, Sample]]] = {}  # in the next one, and not yet before
        self._number = 0
        self._keys: tuple[set[str], set[str]] = (set(), set())

    def before(self, sample: Sample) -> int:
        """The session before has heard a sample; how many bytes wait no more."""
        mark = _mark(sample)
        self._keys[0].add(sample.key)
        waiting = self._ahead.get(mark)
        if not waiting:
            self._heard[mark] += 1
            return 0
        waiting.popleft()
        if not waiting:
            del self._ahead[mark]
        return len(sample.data)

    def next(self, sample: Sample) -> int:
        """The next session has heard a sample; how many bytes wait now."""
        mark = _mark(sample)
        self._keys[1].add(sample.key)
        if self._heard[mark]:
            self._heard[mark] -= 1
            return 0
        self._number += 1
        self._ahead.setdefault(mark, deque()).append((self._number, sample))
        return len(sample.data)

    @property
    def is_whole(self) -> bool:
        """Whether the next session has heard something on each key on which the one before has."""
        return self._keys[0] <= self._keys[1]

    def rest(self) -> list[Sample]:
        """What the next session alone has heard."""
        return [sample for _, sample in sorted(each for waiting in self._ahead.values() for each in waiting)]


def _mark(sample: Sample) -> _Mark:
    return sample.key, blake2b(sample.data, digest_size=_HASH_BYTES).digest()
