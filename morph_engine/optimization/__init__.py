"""One frame's optimization: update rules, schedules, line search and watchdog."""
