"""Certificates, TLS and access control."""
