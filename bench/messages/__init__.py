"""Messages to people away from the bench: webhook, ntfy or e-mail, sent by a thread for each receiver."""
