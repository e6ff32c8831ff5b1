"""Tools for operators: the dashboard, `eal top`, `eal doctor`, metrics and traces."""
