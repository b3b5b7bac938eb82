"""Stores of results, zarr v3: the public interface.

Code outside this package uses only the names listed here. In worker, only this package imports zarr.
"""

from worker.store.backend import DELETED as DELETED
from worker.store.backend import ROOT as ROOT
from worker.store.backend import ChunkCoords as ChunkCoords
from worker.store.backend import StoreConflict as StoreConflict
from worker.store.backend import StoreDamaged as StoreDamaged
from worker.store.backend import StoreError as StoreError
from worker.store.backend import StoreMissing as StoreMissing
from worker.store.backend import Unreachable as Unreachable
from worker.store.backend import check_address as check_address
from worker.store.backend import in_bucket as in_bucket
from worker.store.backend import names_in as names_in
from worker.store.backend import read_key as read_key
from worker.store.backend import remove as remove
from worker.store.backend import write_fault as write_fault
from worker.store.encoding import ArrayForm as ArrayForm
from worker.store.encoding import forms_in as forms_in
from worker.store.reader import read_attrs as read_attrs
from worker.store.reader import read_chunk as read_chunk
from worker.store.reader import read_file as read_file
from worker.store.reader import read_slice as read_slice
from worker.store.reader import stored_forms as stored_forms
from worker.store.side_files import MARKER as MARKER
from worker.store.side_files import checkpoints_in as checkpoints_in
from worker.store.side_files import clear_cancelled as clear_cancelled
from worker.store.side_files import is_cancelled as is_cancelled
from worker.store.side_files import read_checkpoint as read_checkpoint
from worker.store.side_files import read_marker as read_marker
from worker.store.side_files import remove_checkpoint as remove_checkpoint
from worker.store.side_files import set_cancelled as set_cancelled
from worker.store.side_files import sweep_leftovers as sweep_leftovers
from worker.store.side_files import write_checkpoint as write_checkpoint
from worker.store.side_files import write_marker as write_marker
from worker.store.store import check_chunk as check_chunk
from worker.store.store import create as create
from worker.store.store import discard as discard
from worker.store.store import keys_of as keys_of
from worker.store.store import metadata_of as metadata_of
from worker.store.store import repair_metadata as repair_metadata
from worker.store.store import restore as restore
from worker.store.store import sync_folders as sync_folders
from worker.store.store import write_chunk as write_chunk
