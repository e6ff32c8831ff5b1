"""The language of scenario files: YAML, parameters, expressions, roles, scopes, and checks before the run."""
