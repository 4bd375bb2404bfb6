"""Report writers: a run folder rendered for people (HTML), build servers (JUnit) and spreadsheets (CSV)."""
