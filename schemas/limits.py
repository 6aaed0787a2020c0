"""Bounds on everything that arrives from outside.

A message that breaks one of them is refused with a `SchemaError` before memory in proportion to its claims is taken."""

MAX_MESSAGE_BYTES = 256 * 1024 * 1024
MAX_ARRAY_BYTES = 256 * 1024 * 1024
MAX_ARRAY_NDIM = 16
MAX_DEPTH = 64
MAX_ITEMS = 1 << 20
"""Entries of one array or map."""

MAX_CONTAINERS = 1 << 18
"""Arrays and maps in one value: an empty map of one byte takes some ninety of memory."""

MAX_ENTRIES = 1 << 21
"""Entries of all arrays and maps in one value: one of two or three bytes takes some seventy of memory."""

MAX_PLAIN_BYTES = 16 * 1024 * 1024
"""What a message along an edge has besides its large arrays, which are read in place: of the rest memory may take
many times as much."""

MAX_WORD_BYTES = 64 * 1024
"""A control message that holds neither a roster nor a state."""

MAX_STATE_BYTES = 64 * 1024 * 1024
"""A control message that does."""

MAX_QUESTION_BYTES = 1024 * 1024
"""A question to a node or a supervisor."""

MAX_NAME_CHARS = 128
MAX_TEXT_CHARS = 4096
"""A reason in a control message."""

MAX_NEIGHBOURS = 4096
"""Names in one control message, but for a roster's."""

MAX_NUMBER = (1 << 53) - 1
"""Epochs, attempts, versions and instances in a control message: no run comes near."""

LARGEST = (1 << 63) - 1
"""A seed, or how many epochs are asked for: what a message carries as a whole number, and a recording, too."""

MAX_EXTENSIONS = 64

MAX_EPOCHS_APART = 10_000
"""How seldom a node may take part in an epoch, and how much later what is predicted may count."""

LARGE_ARRAY_BYTES = 16 * 1024
"""Arrays from this size up travel behind the payload, where they can be read in place."""
