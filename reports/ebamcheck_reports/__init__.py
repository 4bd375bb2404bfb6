"""Report writers: a run folder rendered for people (HTML), build servers (JUnit) and spreadsheets (CSV)."""

# Entry points of writers that read ``run.json`` alone: `ebamcheck verify` makes their files again and compares them
OF_RECORD = ("junit", "summary")
