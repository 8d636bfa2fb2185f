"""Issues a calibration certificate as signed files: the PDF, with the DCC attached."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

from gyrobench.bench.certificate.content import Certificate
from gyrobench.bench.certificate.dcc import certificate_dcc, validate_dcc
from gyrobench.bench.certificate.pdf import certificate_pdf
from gyrobench.bench.certificate.signatures import SigningKey, sign_dcc, sign_pdf
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.runs.provenance import SIMULATED

FORMATS = ("dcc", "pdf")


def file_names(certificate: Certificate, formats: Iterable[str]) -> dict[str, str]:
    """Names of the certificate's files by format; those of an emulated run are marked."""
    mark = f"_{SIMULATED}" if certificate.run.is_simulated else ""
    suffixes = {"pdf": "pdf", "dcc": "xml"}
    return {each: f"certificate{mark}.{suffixes[each]}" for each in formats}


def issue_certificate(
    certificate: Certificate, formats: Collection[str], out: Path, key: SigningKey | None, schema: Path | None
) -> list[Path]:
    """Write a certificate into the folder ``out`` after all its files were created; returns their paths.

    ``formats``: some of :data:`FORMATS`. ``key``: signs the files, if given. ``schema``: folder of PTB's
    schemas against which the DCC is validated, if given. Raises DocumentError if the DCC is not valid, or the
    folder holds a certificate: the one that a customer has must not be lost.
    """
    names = file_names(certificate, formats)
    issued = [name for name in file_names(certificate, FORMATS).values() if (out / name).exists()]
    if issued and not certificate.run.is_simulated:
        raise DocumentError(
            f"{out / issued[0]}: was issued before. Give --out for another certificate, and --replaces "
            "NUMBER if it replaces that one"
        )
    files: dict[str, bytes] = {}
    if "dcc" in formats:
        document = certificate_dcc(certificate)
        if key:
            document = sign_dcc(document, key)
        if schema is not None:
            validate_dcc(document, schema)
        files[names["dcc"]] = document
    if "pdf" in formats:
        pdf = certificate_pdf(certificate, files)
        reason = f"Calibration certificate {certificate.number}"
        files[names["pdf"]] = sign_pdf(pdf, key, reason) if key else pdf
    make_folder(out)
    for name, data in files.items():
        write_whole(out / name, data)
    return [out / name for name in files]
