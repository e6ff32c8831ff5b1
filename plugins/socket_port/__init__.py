"""A TCP or UDP connection as a communication resource."""
