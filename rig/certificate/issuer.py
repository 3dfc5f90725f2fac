"""Who issues a certificate, for whom, and who signs it: a file of the laboratory's own (ISO/IEC 17025:2017, 7.8.2)."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Text = Annotated[str, Field(min_length=1)]
Country = Annotated[str, Field(pattern="^[A-Z]{2}$", description="ISO 3166-1, two letters")]


class Strict(BaseModel):
    """Settings that refuse what they do not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Party(Strict):
    """A laboratory or a customer."""

    name: Text
    address: Text | None = None
    country: Country | None = None
    email: Text | None = None
    code: Text | None = Field(default=None, description="of a laboratory, such as that of its accreditation")

    @property
    def words(self) -> str:
        """Name and address on one line."""
        return ", ".join(part for part in (self.name, self.code, self.address, self.country, self.email) if part)


class Signatory(Strict):
    """Who answers for a certificate."""

    name: Text
    role: Text


class Issuer(Strict):
    """The laboratory's part of a certificate; the first of the `signatories` signs."""

    laboratory: Party
    customer: Party | None = None
    order: Text | None = None
    place: Literal["laboratory", "customer", "other"] = "laboratory"
    issued: dt.date | None = None
    signatories: tuple[Signatory, ...] = ()
