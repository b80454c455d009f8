//! Mesh files for palpate: OBJ, glTF, STL and PLY loading, welding, repair and self-intersection checks.
