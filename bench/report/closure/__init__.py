"""The search for effects: its text, figures, page and terminal summary."""
