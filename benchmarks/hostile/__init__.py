"""What strangers and large databases may do to a real service, against bars on time and memory.

A trial starts a service of its own and prints its figures; `python -m benchmarks.hostile NAME`.
What does not depend on the machine's speed is a test:

| what | as a trial | as a test |
|---|---|---|
| database and data on one full disk | | `test_disk_of_database_and_data_full` |
| the largest sweep | `sweeps` | `test_a_sweep_is_counted_before_it_is_made` |
| heads over 64 KiB, or without an end | `large_heads` | `test_api_connections.py` |
| 5000 slow sockets | `slow_sockets` | `test_slow_connections_leave_room` |
| `retry` broken off | | `test_a_retry_may_break_off_anywhere` |
| 200 reads that need children | `reads` | `test_reads_stay_within_the_budget` |
| 100 000 finished jobs | `finished` | |
| extreme jobs: memory expected and taken | `extreme` | `test_cost.py` |
| 200 parallel submits | | `test_parallel_submits_stay_within_the_quota` |
| a valid upload behind 100 bombs | `bombs` | `test_an_upload_overtakes_those_of_another_key` |
| foreign `Origin` or `Host` | | `test_api_keys.py` |
| 50 idle workers on one Postgres | `idle` | |
"""
