"""What travels: values, messages, arrays, keys and their limits. No input or output here."""
