"""Seeded histories of jobs: what owners, workers and the janitor do, in an order drawn by chance."""
