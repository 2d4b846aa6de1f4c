"""The report of a campaign: one HTML file that needs nothing else. `data` reads the run, `page` writes it down."""
