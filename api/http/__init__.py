"""The web application: routes, live events, access, errors, metrics."""
