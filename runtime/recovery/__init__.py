"""Records that outlive the process that wrote them."""
