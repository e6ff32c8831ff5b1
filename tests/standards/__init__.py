"""One scenario on four robots of different standards, each behind an end of its own."""
