"""Report writers: renderings of a run folder for people (HTML), for build servers (JUnit) and for tables (CSV)."""
