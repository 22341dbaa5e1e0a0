"""Engine processes as their worker sees them."""
