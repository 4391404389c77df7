"""Files of measured signals -> labelled records, and back."""

from smfe.records.blocks import read_blocks
from smfe.records.clocks import put_on_clock, put_on_time
from smfe.records.contents import column_names, names_itself
from smfe.records.decimate import read_reduced, reduced
from smfe.records.formats.channels import CHANNELS, COMPLIANCE_CHANNELS, RECORD_CHANNELS, Channel
from smfe.records.frf import read_frf, read_universal_frfs
from smfe.records.read import FORMATS, read_record, read_records
from smfe.records.write import (
    OWN_COLUMNS,
    record_columns,
    write_pieces_csv,
    write_pieces_netcdf,
    write_record_csv,
    write_record_mat,
    write_record_netcdf,
)
from smfe.records.write_uff import uff_columns, write_compliance_uff, write_record_uff

__all__ = [
    "CHANNELS",
    "COMPLIANCE_CHANNELS",
    "FORMATS",
    "OWN_COLUMNS",
    "RECORD_CHANNELS",
    "Channel",
    "column_names",
    "names_itself",
    "put_on_clock",
    "put_on_time",
    "read_blocks",
    "read_frf",
    "read_record",
    "read_records",
    "read_reduced",
    "read_universal_frfs",
    "record_columns",
    "reduced",
    "uff_columns",
    "write_compliance_uff",
    "write_pieces_csv",
    "write_pieces_netcdf",
    "write_record_csv",
    "write_record_mat",
    "write_record_netcdf",
    "write_record_uff",
]
