//! Round trips, and files damaged in every place.

use super::*;
use crate::flat::{Array, Mesh, array::Element, sample};
use memmap2::MmapMut;
use std::{fs, path::PathBuf};

fn name(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("dermis_file_{}_{name}.dermis", std::process::id()))
}

fn bytes_of(scene: &FlatScene) -> Vec<u8> {
    let mut bytes = Vec::new();
    write(scene, &mut bytes).unwrap();
    bytes
}

fn mapped(bytes: &[u8]) -> Arc<Mmap> {
    let mut map = MmapMut::map_anon(bytes.len().max(1)).unwrap();
    map[..bytes.len()].copy_from_slice(bytes);
    Arc::new(map.make_read_only().unwrap())
}

/// A scene whose file is a few hundred bytes: one triangle.
fn small() -> FlatScene {
    let mut scene = FlatScene::default();
    let mesh = Mesh {
        points: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].into(),
        face_vertex_counts: vec![3].into(),
        face_vertex_indices: vec![0, 1, 2].into(),
        ..Mesh::default()
    };
    scene.meshes.insert("/triangle".into(), mesh);
    scene
}

fn field_of(bytes: &[u8]) -> Option<String> {
    read(&mapped(bytes)).err().map(|fault| fault.field)
}

#[test]
fn loads_what_was_saved() {
    let file = name("round");
    let scene = sample::scene();
    save(&scene, &file).unwrap();
    let mut loaded = load(&file).unwrap();
    assert_eq!(loaded, scene);
    // The file is as before when saved again over its own map.
    save(&loaded, &file).unwrap();
    assert_eq!(loaded.validate(), []);
    assert_eq!(load(&file).unwrap(), scene);
    fs::remove_file(file).unwrap();
}

#[test]
fn transforms_come_back() {
    let mut scene = small();
    let mesh = scene.meshes.get_mut("/triangle").unwrap();
    mesh.transform[3] = [1.0 / 3.0, -1e7 / 7.0, f64::MIN_POSITIVE, 1.0];
    let read = read(&mapped(&bytes_of(&scene))).unwrap();
    let (read, written) = (&read.meshes["/triangle"].transform[3], &scene.meshes["/triangle"].transform[3]);
    for (read, written) in read.iter().zip(written) {
        // serde_json rounds text to the nearest double only with its feature `float_roundtrip`.
        assert!((read - written).abs() <= f64::EPSILON * written.abs(), "{read} {written}");
    }
}

#[test]
fn floats_come_back_bit_for_bit() {
    let mut scene = small();
    let light = crate::flat::Light { color: [0.1, 1.0 / 3.0, 1e-38], intensity: 1.2345679e20, ..Default::default() };
    scene.lights.insert("/light".into(), light);
    assert_eq!(read(&mapped(&bytes_of(&scene))).unwrap(), scene);
}

#[test]
fn arrays_are_mapped_and_aligned() {
    fn check<T: Element>(map: &Mmap, array: &Array<T>) {
        let at = array.as_ptr().cast::<u8>();
        assert!(map.as_ptr_range().contains(&at) || array.is_empty(), "owned");
        assert_eq!(at as usize % ALIGNMENT, 0);
    }
    let map = mapped(&bytes_of(&sample::scene()));
    let mut scene = read(&map).unwrap();
    // Nothing to repair: validation leaves them mapped.
    assert_eq!(scene.validate(), []);
    let cube = &scene.meshes["/cube"];
    check(&map, &cube.points);
    check(&map, &cube.face_vertex_counts);
    check(&map, &cube.face_vertex_indices);
    check(&map, &cube.hole_indices);
    check(&map, &cube.geom_subsets[0].indices);
    check(&map, &cube.display_color.as_ref().unwrap().values);
    let crate::flat::AnyPrimvar::Float2(st) = &cube.primvars["st"] else { panic!("two components") };
    check(&map, st.indices.as_ref().unwrap());
    let crate::flat::Texels::U8(texels) = &scene.images["@pores.png@"].texels else { panic!("bytes") };
    check(&map, texels);
    check(&map, &scene.instancers["/tree"].transforms);
    check(&map, &scene.textures["/sky.exr"].pixels);
}

#[test]
fn a_file_cut_short_is_an_error_at_every_length() {
    let bytes = bytes_of(&small());
    for length in 0..bytes.len() {
        let field = field_of(&bytes[..length]).unwrap_or_else(|| panic!("{length} bytes were taken"));
        // An empty map is one zero byte.
        assert_eq!(field, if length < MAGIC.len() { "magic" } else { "header" }, "{length} bytes");
    }
    let longer = [&bytes[..], &[0]].concat();
    assert_eq!(field_of(&longer).as_deref(), Some("header"));
}

#[test]
fn every_damaged_byte_is_named_or_harmless() {
    let bytes = bytes_of(&small());
    let text_end = HEADER + u64_at(&bytes, 8) as usize;
    let table = text_end.next_multiple_of(8);
    let arrays = table + ENTRY * u64_at(&bytes, 16) as usize;
    for at in 0..bytes.len() {
        for mask in [1, 0x80, 0xff] {
            let mut damaged = bytes.clone();
            damaged[at] ^= mask;
            let expected = match at {
                0..6 => Some("magic".to_owned()),
                6..8 => Some("version".to_owned()),
                8..HEADER => Some("header".to_owned()),
                _ if at < text_end => Some("text".to_owned()),
                _ if at >= table && at < arrays => Some(format!("table entry {}", (at - table) / ENTRY)),
                // Padding and array content: validate() repairs what matters.
                _ => None,
            };
            assert_eq!(field_of(&damaged), expected, "byte {at} ^ {mask}");
            if let Ok(mut scene) = read(&mapped(&damaged)) {
                scene.validate();
                assert_eq!(scene.validate(), [], "byte {at} ^ {mask}");
            }
        }
    }
}

/// Damage that keeps its checksums: a file that another program wrote wrongly.
#[test]
fn wrong_contents_with_right_checksums_are_named() {
    let bytes = bytes_of(&small());
    let table = (HEADER + u64_at(&bytes, 8) as usize).next_multiple_of(8);
    let with = |at: usize, value: u64, sums: &[(usize, usize)]| {
        let mut bytes = bytes.clone();
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        for &(start, end) in sums {
            let sum = checksum(&bytes[start..end]);
            bytes[end..end + 8].copy_from_slice(&sum.to_le_bytes());
        }
        field_of(&bytes).unwrap_or_else(|| panic!("{value} at {at} was taken"))
    };
    let header = [(0, 56)];
    for huge in [u64::MAX, u64::MAX / 2, 1 << 40] {
        assert_eq!(with(8, huge, &header), "text");
        assert_eq!(with(16, huge, &header), "table");
        assert_eq!(with(24, huge, &header), "header");
        let entry = [(table, table + 24)];
        assert_eq!(with(table + 8, huge & !63, &entry), "array 0");
        assert_eq!(with(table + 16, huge, &entry), "array 0");
        assert_eq!(with(table, huge | 3, &entry), "table entry 0");
        assert_eq!(with(table + 8, huge | 1, &entry), "table entry 0");
    }
    assert_eq!(with(16, 0, &header), "text", "arrays that the text names are not in the table");
    assert_eq!(with(table, 1 | (3 << 32), &[(table, table + 24)]), "text", "f64 where f32 belongs");
}

#[test]
fn garbage_is_not_a_scene() {
    let mut state = 1_u64;
    let mut random = || {
        // Knuth's MMIX generator; its high bits.
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    };
    for length in 0..600 {
        let mut bytes: Vec<u8> = (0..length).map(|_| random()).collect();
        assert_eq!(field_of(&bytes).as_deref(), Some("magic"));
        let start = bytes.len().min(8);
        bytes[..start].copy_from_slice(&b"DERMIS\x01\x00"[..start]);
        assert!(field_of(&bytes).is_some());
    }
}

#[test]
fn errors_name_the_file() {
    let missing = load(Path::new("/no/such/scene.dermis")).unwrap_err().to_string();
    assert!(missing.starts_with("/no/such/scene.dermis: file: "), "{missing}");
    assert!(load(&std::env::temp_dir()).is_err());
    let file = name("newer");
    let mut bytes = bytes_of(&small());
    bytes[6] = 9;
    fs::write(&file, &bytes).unwrap();
    let newer = load(&file).unwrap_err().to_string();
    assert!(newer.ends_with("version: version 9, this program reads 3; flatten the stage again"), "{newer}");
    fs::write(&file, []).unwrap();
    assert!(load(&file).unwrap_err().to_string().contains("magic"));
    fs::remove_file(file).unwrap();
    let mut scene = small();
    scene.settings.samples = 0;
    assert!(save(&scene, &name("refused")).unwrap_err().to_string().contains("samples is 0"));
}

#[test]
fn a_scene_with_nan_is_saved_repaired() {
    let file = name("nan");
    let mut scene = small();
    scene.cameras.insert("/camera".into(), crate::flat::Camera { focal_length: f32::NAN, ..Default::default() });
    save(&scene, &file).unwrap();
    let loaded = load(&file).unwrap();
    fs::remove_file(file).unwrap();
    assert_eq!(loaded.cameras["/camera"].focal_length, 50.0);
    assert_eq!(loaded.warnings.len(), 1);
}
