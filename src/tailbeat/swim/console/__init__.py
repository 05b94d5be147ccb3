"""The operator's page: `snapshot` is what it shows, `desk` the owner's end, `server` serves."""
