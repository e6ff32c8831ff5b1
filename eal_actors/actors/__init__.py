"""Actors: the only place that knows of Pykka. Mailboxes, futures, resource and robot actors, supervision, handles."""
