"""Sections of the HTML report: each is a function of the run that returns markup."""
