"""Detection of changes between pictures of one place, and the scenario step `compare_views`."""
