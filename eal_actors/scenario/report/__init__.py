"""The results of a run: events, the summary, saved answers, the timeline of a plan, and the state to resume from."""
