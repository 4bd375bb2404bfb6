"""Settings of the connection to a control by OPC UA: where it is, who may write, which nodes are which."""

from __future__ import annotations

from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import Field, field_validator, model_validator

from ebamcheck.settings.base import Between, Section

Seconds = Annotated[float, Between(0.01, 1e6)]  # time to wait, s

ROLES = (
    "done",
    "released",
    "number",
    "wait",
    "waited",
    "height",
    "measured",
    "begin_at",
    "owner",
    "digest",
    "key",
    "seal",
)
"""What the nodes of the handshake are called here, in the order in which their R parameters follow on ``machine.live_r``,
where that of the time left (R5) is left out: the program alone uses it."""

TEXT_ROLES = (
    "name",
    "sha256",
    "map",
)  # further nodes, of text, which a control has only where the settings name them

WARMTH_ROLES = ("surface_k", "after_s")  # the same of numbers, of a pyrometer


class OpcuaSettings(Section):
    """The control as an OPC UA server (`ebamcheck live RUN --opcua`); the defaults are those of a SINUMERIK 840D sl."""

    url: str = "opc.tcp://127.0.0.1:4840"
    """Address of the server of the control."""
    security: Literal["sign_and_encrypt", "sign", "none"] = "sign_and_encrypt"
    """How messages are protected. `none` is for a desk: it takes no password and needs `anonymous`."""
    policy: Literal["Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss"] = "Basic256Sha256"
    """Security policy of the channel."""
    certificate: str = ""
    """File of our certificate, PEM or DER; needed unless security is `none`."""
    private_key: str = ""
    """File of its key, PEM or DER."""
    server_certificate: str = ""
    """File of the certificate of the control: no other server is spoken to. Needed unless security is `none`."""
    application_uri: str = "urn:ebamcheck:live"
    """Name of this program in its certificate."""
    user: str = ""
    """User of the control who may write R parameters and files; needed unless `anonymous`."""
    password_variable: str = "EBAMCHECK_OPCUA_PASSWORD"
    """Environment variable that holds the password: passwords do not belong into settings, which go into records."""
    password_file: str = ""
    """File that holds the password, where that variable is not set; readable by its owner alone."""
    anonymous: bool = False
    """Write without a user: for a desk alone."""
    r_node: str = "ns=2;s=/Channel/Parameter/R[u1,{r}]"
    """Node of an R parameter; {r} is its number."""
    nodes: dict[str, str] = Field(default={})
    """Nodes that are no R parameters, by what they are: done, released, number, wait, waited, height, measured, begin_at, owner,
    digest, key, seal (the waiting main program reads its own in R parameters); and, where the control has such variables for text, name and sha256, which are written, and map: the name of the file of
    a height map, which stands for the height where it is not empty; and surface_k and after_s, the temperature
    that a pyrometer read, K, and how long after the layer, s, which are used where the first is not 0."""
    methods_node: str = "ns=2;s=/Methods"
    """Object whose methods copy files."""
    upload_node: str = "ns=2;s=/Methods/CopyFileToServer"
    """Method that writes a file: name, content, whether one that is there is replaced."""
    download_node: str = "ns=2;s=/Methods/CopyFileFromServer"
    """Method that reads a file: name."""
    folder: str = "Sinumerik/FileSystem/Work Pieces/{directory}.WPD"
    """Folder of the programs on the control; {directory} is machine.workpiece_directory."""
    file_limit_mb: Annotated[float, Between(0.001, 1e4)] = 16.0
    """Greatest file that the control takes, of 10^6 bytes; a layer that is larger is not released."""
    replace: bool = False
    """Replace a file of another build that has the name of a layer. Off, the layer is kept back until somebody deletes it."""
    grid_s: Annotated[float, Between(0.01, 60.0)] = 0.1
    """Sampling and publishing interval of the subscription; a SINUMERIK knows 100 ms, 250 ms and more."""
    look_s: Annotated[float, Between(0.05, 600.0)] = 1.0
    """The values are read at least this often, whether the subscription reports or not."""
    request_s: Seconds = 10.0
    """Longest time for an answer of the control; after it the connection counts as lost."""
    retry_s: Seconds = 1.0
    """Time before the next try, of a connection or of a layer that was not taken; it doubles up to `longest_retry_s`."""
    longest_retry_s: Seconds = 30.0
    """Longest time between two tries."""
    late_s: Seconds = 600.0
    """Time after a layer is done, without its height, after which `live` says that it is late."""

    @field_validator("url")
    @classmethod
    def _is_a_url(cls, value: str) -> str:
        if not value.startswith("opc.tcp://") or "@" in value or len(value) <= len("opc.tcp://"):
            raise ValueError(
                "give opc.tcp://HOST:PORT, without a user: that is opcua.user, its password in a variable"
            )
        try:
            port = urlsplit(value).port
        except ValueError:
            port = None
        if not port:
            raise ValueError("no port from 1 to 65535: give opc.tcp://HOST:PORT, that of a SINUMERIK is 4840")
        return value

    @field_validator("nodes")
    @classmethod
    def _known_roles(cls, value: dict[str, str]) -> dict[str, str]:
        known = (*ROLES, *TEXT_ROLES, *WARMTH_ROLES)
        for role in value:
            if role not in known:
                raise ValueError(f"{role!r} is none of {', '.join(known)}")
        return value

    @field_validator("r_node")
    @classmethod
    def _has_its_number(cls, value: str) -> str:
        if value.count("{r}") != 1:
            raise ValueError("give the place of the number, {r}, once")
        return value

    @model_validator(mode="after")
    def _rising_waits(self) -> Self:
        if self.longest_retry_s < self.retry_s:
            raise ValueError("longest_retry_s must be at least retry_s")
        return self

    @property
    def problem(self) -> str:
        """What is missing for a connection that may write; empty: nothing."""
        if self.security == "none":
            if not self.anonymous:
                return "opcua.security is 'none': set opcua.anonymous for a desk; no password goes over an open channel"
            return ""
        for key in ("certificate", "private_key", "server_certificate"):
            if not getattr(self, key):
                return f"opcua.{key} is missing: give a file (the profile for a desk is written by `ebamcheck machine RUN --opcua`)"
        if not self.user and not self.anonymous:
            return "opcua.user is missing: nothing is written without a user unless opcua.anonymous is set"
        return ""
