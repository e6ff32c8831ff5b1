"""Metrics in the format of Prometheus, of robots that run or are commanded in this process."""
