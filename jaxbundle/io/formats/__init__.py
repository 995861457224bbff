"""Blocks in the formats of other programs.

A reader `read_x(path, options) -> ForeignBlock` knows the grammar and the conventions of one format. `assembled`
makes a block of what any of them read: it decides between readings by the misfit of the rays, leaves out what cannot
take part, and brings the block into the system of its control. A writer `write_x(block, path) -> losses` says what
its format cannot hold.

    foreign_block   the types that every reader fills
    source          text, JSON and XML, faults told with file and line
    rotations       matrices, quaternions, vectors and angles of many images
    misfit, decided, usable_part, control_system, assembled      from ForeignBlock to Block
    written         from Block to what writers take
    ground_control  gcp_list.txt, geo.txt and tables of control beside a block
    format_table    the table of all formats
"""
