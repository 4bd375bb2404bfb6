"""Settings that programs read: the same values as with their explanations, in a tenth of the time."""

import tomllib

from ebamcheck.settings.checking import as_toml, values_as_toml
from ebamcheck.settings.config import Config, validated


def test_values_are_those_of_the_text_that_explains_itself():
    changed = Config().changed(
        process={
            "keep_out": [{"outline_mm": [[0, 0], [20, 0], [20, 10]], "z_mm": [0, 50]}],
            "interpass_limit_k": 700.0,
        },
        machine={"set_focus": ["H5={defocus} ; focus"], "program_name": "OTHER"},
        preheat={"when": "plate", "defocus": 20.0},
        layers={"heights_mm": [0.5, 1.5, 3.0]},
        opcua={"nodes": {"height": "ns=2;s=/Plc/DB200.DBD4:REAL"}},
    )
    for config in (Config(), changed, Config()):
        plain, told = values_as_toml(config), as_toml(config)
        assert validated(tomllib.loads(plain), "plain") == config == validated(tomllib.loads(told), "told")
        assert tomllib.loads(plain) == tomllib.loads(told)
        assert plain.count("#") - plain.count(" # ") < 40 < told.count("#")
        assert len(plain) < 0.5 * len(told)
