"""How far slicers are from the truth and how fast: reports against baselines, the choice of a machine, and the heat model beside a
code of others."""
