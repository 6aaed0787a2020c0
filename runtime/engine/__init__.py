"""One node's protocol, without input or output: messages in, messages and events out."""
