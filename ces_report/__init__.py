"""Tables, charts and the frame of pages: records go in, HTML, SVG and text come out."""
