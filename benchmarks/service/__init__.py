"""The job service measured with real processes: latency, fairness, load."""
