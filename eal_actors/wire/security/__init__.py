"""TLS, access control, and bounds for strangers."""
