"""Durable execution of morph jobs: queue, engine processes, storage, adoption of lost work."""
