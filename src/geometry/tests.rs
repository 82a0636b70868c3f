use std::path::{Path, PathBuf};

use super::*;

/// The unit cube as faces of four corners, outward.
const CORNERS: [[f64; 3]; 8] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.0, 1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [1.0, 0.0, 1.0],
    [1.0, 1.0, 1.0],
    [0.0, 1.0, 1.0],
];
const FACES: [[usize; 4]; 6] = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [2, 3, 7, 6], [1, 2, 6, 5], [0, 4, 7, 3]];

fn obj() -> String {
    let vertices = CORNERS.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n"));
    let faces = FACES.iter().map(|f| format!("f {} {} {} {}\n", f[0] + 1, f[1] + 1, f[2] + 1, f[3] + 1));
    format!("mtllib none.mtl\no cube\nusemtl red\n{}{}", vertices.collect::<String>(), faces.collect::<String>())
}

fn triangles() -> Vec<[[f64; 3]; 3]> {
    let fan = |f: &[usize; 4]| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]].map(|t| t.map(|i| CORNERS[i]));
    FACES.iter().flat_map(fan).collect()
}

fn ascii_stl() -> String {
    let vertex = |[x, y, z]: [f64; 3]| format!("vertex {x} {y} {z}\n");
    let facet =
        |t: [[f64; 3]; 3]| format!("facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n", t.map(vertex).concat());
    format!("solid cube\n{}endsolid cube\n", triangles().into_iter().map(facet).collect::<String>())
}

fn binary_stl() -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend(12u32.to_le_bytes());
    for t in triangles() {
        bytes.extend([0u8; 12]);
        t.as_flattened().iter().for_each(|x| bytes.extend((*x as f32).to_le_bytes()));
        bytes.extend([0u8; 2]);
    }
    bytes
}

fn ply(faces: &str) -> String {
    let vertices: String = CORNERS.iter().map(|[x, y, z]| format!("{x} {y} {z} 255\n")).collect();
    format!(
        "ply\nformat ascii 1.0\nelement vertex 8\nproperty double x\nproperty float y\nproperty float z\nproperty uchar red\n\
         element face 6\nproperty list uchar int {faces}\nend_header\n{vertices}{}",
        FACES.iter().map(|f| format!("4 {} {} {} {}\n", f[0], f[1], f[2], f[3])).collect::<String>()
    )
}

fn keys(path: &Path) -> MeshKeys {
    MeshKeys { path: path.into(), ..MeshKeys::default() }
}

fn written(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

fn cube(change: impl Fn(&mut MeshKeys)) -> Geometry {
    let folder = tempfile::tempdir().unwrap();
    let mut keys = keys(&written(folder.path(), "cube.obj", obj()));
    change(&mut keys);
    Geometry::load(&[keys]).unwrap().unwrap()
}

#[test]
fn every_format_gives_the_same_cube() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, bytes: &[u8]| written(folder.path(), name, bytes);
    for path in [
        at("a.obj", obj().as_bytes()),
        at("b.STL", ascii_stl().as_bytes()),
        at("c.stl", &binary_stl()),
        at("d.ply", ply("vertex_indices").as_bytes()),
        at("e.ply", ply("vertex_index").as_bytes()),
    ] {
        let cube = Geometry::load(&[keys(&path)]).unwrap().unwrap();
        assert_eq!((cube.triangles.size(), cube.bounds[0]), (12, (DVec3::ZERO, DVec3::ONE)), "{path:?}");
        let hit = cube.first_hit(DVec3::new(0.3, 0.4, 5.0), DVec3::NEG_Z, 100.0).unwrap();
        assert!((hit.t - 4.0).abs() < 1e-12 && hit.normal == DVec3::Z, "{path:?}: {hit:?}");
    }
    assert!(Geometry::load(&[]).unwrap().is_none());
}

#[test]
fn rays_meet_what_is_nearest_from_both_sides_within_reach() {
    let cube = cube(|_| ());
    let along = |origin: [f64; 3], direction: [f64; 3], t_max: f64| {
        cube.first_hit(origin.into(), direction.into(), t_max).map(|hit| (hit.t, hit.normal.to_array()))
    };
    assert_eq!(along([0.5, 0.4, -2.0], [0.0, 0.0, 1.0], 9.0), Some((2.0, [0.0, 0.0, -1.0])));
    // From inside, twice as fast.
    assert_eq!(along([0.5, 0.4, 0.5], [2.0, 0.0, 0.0], 9.0), Some((0.25, [-1.0, 0.0, 0.0])));
    assert_eq!(along([0.5, 0.4, -2.0], [0.0, 0.0, 1.0], 1.9), None);
    assert_eq!(along([0.5, 0.4, -2.0], [0.0, 0.0, -1.0], 9.0), None);
    assert_eq!(along([1.5, 0.4, -2.0], [0.0, 0.0, 1.0], 9.0), None);
    // What starts on a surface leaves it.
    assert_eq!(along([0.5, 0.4, 0.0], [0.0, 0.0, 1.0], 9.0), Some((1.0, [0.0, 0.0, -1.0])));
    // Along a face: beside the others, not through them.
    assert_eq!(along([0.5, 0.0, -2.0], [0.0, 0.0, 1.0], 9.0).map(|(t, _)| t), Some(2.0));
    // Through an edge and through a corner: no gap between triangles.
    assert!(along([0.5, 0.5, -1.0], [0.0, 0.0, 1.0], 9.0).is_some());
    assert!(along([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0], 9.0).is_some_and(|(t, _)| (t - 1.0).abs() < 1e-12));
}

/// The tree finds what looking at every triangle finds.
#[test]
fn the_tree_agrees_with_brute_force() {
    use rand::{Rng as _, SeedableRng as _};
    let mut rng = rand_xorshift::XorShiftRng::seed_from_u64(7);
    let mut number = move || f64::from(rng.next_u32()) / f64::from(u32::MAX);
    let mut point = move || DVec3::new(number(), number(), number());
    let soup = |point: &mut dyn FnMut() -> DVec3| Triangle {
        corner: point(),
        edges: [0.6 * (point() - 0.5), 0.6 * (point() - 0.5)],
        mesh: 0,
    };
    let triangles: Vec<Triangle> = (0..300).map(|_| soup(&mut point)).collect();
    let copy = |t: &Triangle| Triangle { corner: t.corner, edges: t.edges, mesh: t.mesh };
    let tree = RTree::bulk_load(triangles.iter().map(copy).collect());
    let geometry = Geometry { triangles: tree, colors: vec![[1.0; 3]], bounds: vec![(DVec3::ZERO, DVec3::ONE)] };
    let mut met = 0;
    for _ in 0..2000 {
        let (origin, direction) = (3.0 * point() - 1.0, point() - point());
        let all = triangles.iter().filter_map(|t| t.meets(origin, direction)).filter(|t| *t > 0.0);
        let nearest = all.fold(f64::INFINITY, f64::min);
        let found = geometry.first_hit(origin, direction, f64::INFINITY).map_or(f64::INFINITY, |hit| hit.t);
        assert_eq!(found, nearest);
        met += u32::from(found.is_finite());
    }
    assert!(met > 100, "{met} rays met something");
}

#[test]
fn meshes_are_scaled_turned_and_moved() {
    let placed = cube(|keys| {
        (keys.scale, keys.rotate, keys.position) = (2.0, [0.0, 0.0, 90.0], [10.0, 20.0, 30.0]);
    });
    let (lo, hi) = placed.bounds[0];
    assert!(lo.abs_diff_eq(DVec3::new(8.0, 20.0, 30.0), 1e-12) && hi.abs_diff_eq(DVec3::new(10.0, 22.0, 32.0), 1e-12));
    let near = Grid { origin: [0.0; 3], ..Grid::new([9, 30, 40]) };
    assert!(placed.check(&near).is_ok());
    let why = placed.check(&Grid::new([4, 4, 4])).unwrap_err().to_string();
    assert!(why.contains("meshes.0.position") && why.contains("[8.0, 20.0, 30.0]") && why.contains("3.5"), "{why}");
}

/// A ball of many triangles.
fn ball(centre: DVec3, radius: f64) -> Geometry {
    let (across, down) = (48, 24);
    let point = |i: usize, j: usize| {
        let (phi, theta) =
            (i as f64 / across as f64 * std::f64::consts::TAU, j as f64 / down as f64 * std::f64::consts::PI);
        centre + radius * DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    };
    let mut triangles = Vec::new();
    for (i, j) in (0..across).flat_map(|i| (0..down).map(move |j| (i, j))) {
        let [a, b, c, d] = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
        for (p, q, r) in [(a, b, c), (a, c, d)] {
            if (q - p).cross(r - p).length_squared() > 1e-20 {
                triangles.push(Triangle { corner: p, edges: [q - p, r - p], mesh: 0 });
            }
        }
    }
    let bounds = vec![(centre - radius, centre + radius)];
    Geometry { triangles: RTree::bulk_load(triangles), colors: vec![[1.0; 3]], bounds }
}

#[test]
fn voxels_are_blocked_inside_and_where_the_surface_is() {
    let grid = Grid { size: [24, 20, 26], spacing: [0.5, 0.6, 0.4], origin: [1.0, -2.0, 3.0] };
    let (lo, hi) = grid.bounds();
    // One in the middle, one that the grid cuts.
    for centre in [0.5 * (lo + hi), DVec3::new(lo.x, hi.y, 0.5 * (lo.z + hi.z))] {
        let blocked = ball(centre, 3.0).blocked(&grid);
        for (n, blocked) in blocked.iter().enumerate() {
            let at = [n % 24, n / 24 % 20, n / 480];
            let x = DVec3::from(grid.origin) + DVec3::from(at.map(|i| i as f64)) * DVec3::from(grid.spacing);
            let distance = (x - centre).length();
            // Half a diagonal of a voxel, and what a facet lies within the ball.
            assert!(*blocked == 1.0 || distance > 3.0 - 0.03, "{at:?} is inside at {distance}");
            assert!(*blocked == 0.0 || distance < 3.0 + 0.44, "{at:?} is outside at {distance}");
        }
    }
}

/// An open sheet blocks one layer and fills nothing; a line along the edges of triangles is no way out.
#[test]
fn sheets_block_a_layer_and_overlapping_meshes_their_union() {
    let corner = |x: f64, y: f64| DVec3::new(x, y, 4.2);
    let half = |p: DVec3, q: DVec3, r: DVec3| Triangle { corner: p, edges: [q - p, r - p], mesh: 0 };
    let (a, b, c, d) = (corner(-1.0, -1.0), corner(9.0, -1.0), corner(9.0, 9.0), corner(-1.0, 9.0));
    let sheet = Geometry {
        triangles: RTree::bulk_load(vec![half(a, b, c), half(a, c, d)]),
        colors: vec![[1.0; 3]],
        bounds: vec![(a, c)],
    };
    let blocked = sheet.blocked(&Grid::new([8; 3]));
    assert!(blocked.iter().enumerate().all(|(n, b)| (*b == 1.0) == (n / 64 == 4)));

    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), "cube.obj", obj());
    let at = |x: f64| MeshKeys { scale: 4.0, position: [x, 1.5, 1.5], ..keys(&path) };
    let two = Geometry::load(&[at(1.5), at(3.5)]).unwrap().unwrap();
    let blocked = two.blocked(&Grid::new([10; 3]));
    let wanted =
        |n: usize| (2..8).contains(&(n % 10)) && (2..6).contains(&(n / 10 % 10)) && (2..6).contains(&(n / 100));
    // Corners of the cubes lie on faces of voxels: those beyond may count as touched.
    assert!((0..1000).filter(|n| wanted(*n)).all(|n| blocked[n] == 1.0));
    assert_eq!(blocked[(3 * 10 + 3) * 10 + 9], 0.0);
}

#[test]
fn files_that_are_no_meshes_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let cube = obj();
    let without_faces: String = cube.lines().filter(|l| !l.starts_with('f')).map(|l| format!("{l}\n")).collect();
    for (name, bytes, said) in [
        ("a.txt", cube.clone().into_bytes(), ".obj, .stl or .ply"),
        ("empty.obj", vec![], "without triangles"),
        ("points.obj", without_faces.into_bytes(), "without triangles"),
        ("far.obj", cube.replace("f 1 4 3 2", "f 1 4 3 99").into_bytes(), "far.obj"),
        ("nan.obj", cube.replace("v 1 1 1", "v nan 1 1").into_bytes(), "not finite"),
        ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n".to_vec(), "no area"),
        ("words.obj", b"v one two three\nf 1 2 3\n".to_vec(), "words.obj"),
        ("cut.stl", binary_stl()[..200].to_vec(), "cut.stl"),
        ("many.stl", [&[0; 80][..], &u32::MAX.to_le_bytes()].concat(), "many.stl"),
        ("text.ply", b"no ply".to_vec(), "text.ply"),
        ("far.ply", ply("vertex_index").replace("4 0 3 2 1", "4 0 3 2 88").into_bytes(), "corner 88"),
        ("less.ply", ply("vertex_index").replace("4 0 3 2 1", "4 0 3 2 -1").into_bytes(), "face 0"),
        ("many.ply", ply("vertex_index").replace("vertex 8", "vertex 99999999999").into_bytes(), "many.ply"),
        ("none.ply", ply("other").into_bytes(), "without triangles"),
    ] {
        let path = written(folder.path(), name, bytes);
        match Geometry::load(&[keys(&path)]) {
            Err(e @ Error::Format { .. }) => assert!(e.to_string().contains(said), "{name}: {e}"),
            Err(e) => panic!("{name}: {e}"),
            Ok(_) => panic!("{name} was read"),
        }
    }
    assert!(matches!(Geometry::load(&[keys(Path::new("/no/such.obj"))]), Err(Error::Io { .. })));
}
