"""The files of a fleet's keys: its authority, certificates, their expiry and the list of revoked ones."""
