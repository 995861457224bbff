"""Blocks in the formats of other programs.

A reader `read_x(path, options) -> ForeignBlock` implements the grammar and the conventions of one format. `assembled`
makes a block of the result: it chooses between interpretations by the misfit of the rays, leaves out unusable images
and points, and transforms the block into the system of its control. A writer `write_x(block, path) -> losses` returns
sentences about what its format cannot represent.

    foreign_block   the types that all readers return
    source          text, JSON and XML; problems are reported with file and line
    rotations       matrices, quaternions, vectors and angles of many images
    misfit, decided, usable_part, control_system, assembled      from ForeignBlock to Block
    written         from Block to the input of writers
    ground_control  gcp_list.txt, geo.txt and additional tables of control
    format_table    the table of all formats
"""
