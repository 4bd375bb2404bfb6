"""What the text of a control means: words, modal groups, codes, templates, header."""
