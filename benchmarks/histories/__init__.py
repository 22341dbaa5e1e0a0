"""Seeded histories of jobs: owners, workers and the janitor act in an order drawn by chance."""
