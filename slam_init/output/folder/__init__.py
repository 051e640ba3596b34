"""The folder of a command's results: whose it is, and how new results replace earlier ones.

A folder that a command writes to holds one hidden folder of the program::

    .slam-init/files.json       the marker: the command, the version, and the list of the files that it wrote
    .slam-init/lock             held by the process that writes to the folder
    .slam-init/new/             results that are not complete yet
    .slam-init/old/             earlier results while new ones replace them
    .slam-init/journal.json     the renames that replace them

**Whose it is.** A command writes to a folder that is new, empty, or marked by the same command. Every other folder is
refused. A folder of version 0.1 counts as marked. Files on the list of the marker are replaced and removed. Other files
are not touched.

**How results are replaced.** A command writes new results to ``new`` and syncs them. Then it writes the journal, moves
the earlier results to ``old`` and the new ones to their places, writes the marker, and removes the journal. A process
that ends before the journal is written leaves the earlier results as they are. The next command removes the unfinished
ones. If a process ends while the journal exists, the next command completes the renames. If a rename fails, the earlier
results are moved back.
"""

from slam_init.output.folder.marker import Marker, output_error, remedy
from slam_init.output.folder.ownership import check_folder, chosen_folder
from slam_init.output.folder.writing import OutputFolder, staged_names

__all__ = ["Marker", "OutputFolder", "check_folder", "chosen_folder", "output_error", "remedy", "staged_names"]
