"""The roster's owner, in the world's process: which roster an epoch runs under, and when it is done again."""
