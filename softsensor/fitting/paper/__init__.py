"""The paper's procedures by name, and why its gradient search got stuck."""
