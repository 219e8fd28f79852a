"""The job ledger around a job: tool, holes and homes of earlier jobs."""
