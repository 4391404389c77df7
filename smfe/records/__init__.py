"""Files of measured signals -> labelled records, and back."""

from smfe.records.channels import CHANNELS, COMPLIANCE_CHANNELS, RECORD_CHANNELS, Channel
from smfe.records.read import READERS, read_frf, read_records
from smfe.records.write import record_columns, write_record_csv, write_record_mat, write_record_netcdf

__all__ = [
    "CHANNELS",
    "COMPLIANCE_CHANNELS",
    "READERS",
    "RECORD_CHANNELS",
    "Channel",
    "read_frf",
    "read_records",
    "record_columns",
    "write_record_csv",
    "write_record_mat",
    "write_record_netcdf",
]
