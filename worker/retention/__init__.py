"""How much finished jobs take, and when they may be deleted."""
