"""Webhooks: messages about changes of jobs, recorded with the change and sent by the janitor."""
