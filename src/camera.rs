//! The compiled camera: pixels to rays in render space (world translated to the camera).

use crate::flat::{self, Projection, RenderSettings};
use crate::sampling::concentric_disk;
use crate::scene::Keys;
use glam::{DVec3, Mat3, Vec2, Vec3};

/// A camera ray in render space: unit direction, valid for 0 < t < `t_max`.
#[derive(Debug, Clone, Copy)]
pub struct CameraRay {
    pub o: Vec3,
    pub d: Vec3,
    pub t_max: f32,
}

/// Pixels that are rendered: origin at the image's top left, half open; beyond the image lies overscan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DataWindow {
    pub x0: i32,
    pub y0: i32,
    pub x1: i32,
    pub y1: i32,
}

impl DataWindow {
    pub fn width(&self) -> u32 {
        self.x1.abs_diff(self.x0)
    }

    pub fn height(&self) -> u32 {
        self.y1.abs_diff(self.y0)
    }

    pub fn contains(&self, x: i32, y: i32) -> bool {
        (self.x0..self.x1).contains(&x) && (self.y0..self.y1).contains(&y)
    }

    /// Pixels whose centres lie in the NDC window (y up), as CameraUtilFraming does; at least one pixel.
    pub fn from_ndc(resolution: [u32; 2], ndc: [f32; 4]) -> Self {
        let pixel = |x: f32, n: u32| (x * n as f32 - 0.5).ceil() as i32;
        let [w, h] = resolution;
        let (x0, x1) = (pixel(ndc[0], w), pixel(ndc[2], w));
        let (y0, y1) = (pixel(1.0 - ndc[3], h), pixel(1.0 - ndc[1], h));
        Self { x0, y0, x1: x1.max(x0 + 1), y1: y1.max(y0 + 1) }
    }
}

#[derive(Debug, Clone)]
pub struct Camera {
    /// World position of the render-space origin.
    pub origin: DVec3,
    /// Camera axes in render space: columns right, up, back; at the frame.
    axes: Mat3,
    /// Where it stands by time of the shutter; `None`: it stays.
    moves: Option<Box<Keys<Stand>>>,
    /// When the shutter opens and closes, time codes from the frame on.
    pub shutter: [f32; 2],
    /// Full size of the window at unit distance (perspective) or in stage units (orthographic).
    window: Vec2,
    /// Shift of the window's centre, same unit.
    offset: Vec2,
    resolution: Vec2,
    orthographic: bool,
    near: f32,
    far: f32,
    lens_radius: f32,
    focus_distance: f32,
    /// Scale of the image: `ComputeLinearExposureScale`.
    pub exposure: f32,
    pub data_window: DataWindow,
    pub size: [u32; 2],
    /// Width of a pixel over its height; as set, or what `adjustPixelAspectRatio` makes of it.
    pub pixel_aspect_ratio: f32,
}

/// Axes as a matrix has them, not unit, and the eye, in render space.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stand {
    axes: Mat3,
    eye: Vec3,
}

impl Stand {
    fn of(matrix: &flat::Matrix4d, origin: DVec3) -> Self {
        let [right, up, back, eye] = matrix.map(|row| DVec3::new(row[0], row[1], row[2]));
        Self { axes: Mat3::from_cols(right.as_vec3(), up.as_vec3(), back.as_vec3()), eye: (eye - origin).as_vec3() }
    }
}

impl Camera {
    pub fn compile(camera: &flat::Camera, settings: &RenderSettings) -> Self {
        let [right, up, back, origin] = camera.transform.map(|row| DVec3::new(row[0], row[1], row[2]));
        // A scale in the transform does not change a GfFrustum: axes are normalised.
        let axes = Mat3::from_cols(
            right.normalize_or(DVec3::X).as_vec3(),
            up.normalize_or(DVec3::Y).as_vec3(),
            back.normalize_or(DVec3::Z).as_vec3(),
        );
        let size = settings.resolution.map(|n| n.max(1));
        let resolution = Vec2::new(size[0] as f32, size[1] as f32);
        let authored = Vec2::new(camera.horizontal_aperture, camera.vertical_aperture);
        let image_aspect = resolution.x * settings.pixel_aspect_ratio / resolution.y;
        let aperture = conform(authored, image_aspect, &settings.aspect_ratio_conform_policy);
        let pixel_aspect_ratio = match settings.aspect_ratio_conform_policy.as_str() {
            "adjustPixelAspectRatio" => aperture.x / aperture.y * resolution.y / resolution.x,
            _ => settings.pixel_aspect_ratio,
        };
        let orthographic = camera.projection == Projection::Orthographic;
        // Apertures and focal length are in tenths of a stage unit: the unit cancels in perspective.
        let scale = if orthographic { 0.1 } else { 1.0 / camera.focal_length };
        let offset = Vec2::new(camera.horizontal_aperture_offset, camera.vertical_aperture_offset);
        let depth_of_field = !settings.disable_depth_of_field && camera.f_stop > 0.0 && camera.focus_distance > 0.0;
        Self {
            origin,
            axes,
            moves: Self::moves(camera, settings, origin),
            shutter: camera.shutter,
            window: aperture * scale,
            offset: offset * scale,
            resolution,
            orthographic,
            near: camera.clipping_range[0].max(0.0),
            far: camera.clipping_range[1],
            lens_radius: if depth_of_field { camera.focal_length * 0.1 / (2.0 * camera.f_stop) } else { 0.0 },
            focus_distance: camera.focus_distance,
            exposure: camera.exposure_scale,
            data_window: DataWindow::from_ndc(size, settings.data_window_ndc),
            size,
            pixel_aspect_ratio,
        }
    }

    fn moves(camera: &flat::Camera, settings: &RenderSettings, origin: DVec3) -> Option<Box<Keys<Stand>>> {
        let keys = camera.transform_keys.as_ref().filter(|_| !settings.disable_motion_blur && camera.opens())?;
        let stands: Vec<Stand> = keys.transforms.iter().map(|matrices| Stand::of(&matrices[0], origin)).collect();
        stands.windows(2).any(|pair| pair[0] != pair[1]).then(|| Box::new(Keys::new(keys.times.clone(), stands)))
    }

    pub fn is_moving(&self) -> bool {
        self.moves.is_some()
    }

    /// The frame as a time of the shutter: 0 where it opens, 1 where it closes; the nearer end where it is beyond.
    pub fn time_of_frame(&self) -> f32 {
        let [open, close] = self.shutter;
        if close > open { (-open / (close - open)).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// Axes and eye at a time of the shutter, render space.
    fn stand(&self, time: f32) -> (Mat3, Vec3) {
        let Some(moves) = &self.moves else { return (self.axes, Vec3::ZERO) };
        let (a, b, f) = moves.about(time);
        let axes = a.axes + (b.axes - a.axes) * f;
        let unit = Mat3::from_cols(
            axes.x_axis.normalize_or(Vec3::X),
            axes.y_axis.normalize_or(Vec3::Y),
            axes.z_axis.normalize_or(Vec3::Z),
        );
        (unit, a.eye + (b.eye - a.eye) * f)
    }

    /// Number of a pixel in the whole image, whatever window is rendered: the key of its random numbers. Overscan has
    /// numbers of its own, hashed since no row holds it.
    pub fn pixel_number(&self, x: i32, y: i32) -> u32 {
        let [width, height] = self.size;
        match (u32::try_from(x), u32::try_from(y)) {
            (Ok(x), Ok(y)) if x < width && y < height => y * width + x,
            _ => {
                let mixed = (x as u32).wrapping_mul(0x9e37_79b9) ^ (y as u32).wrapping_mul(0x85eb_ca6b).rotate_left(16);
                mixed.wrapping_mul(0xc2b2_ae35) | 1 << 31
            }
        }
    }

    pub fn has_depth_of_field(&self) -> bool {
        self.lens_radius > 0.0 && !self.orthographic
    }

    /// Ray through image position `raster` (pixels, y down) at a time of the shutter; `u_lens` chooses the point on the
    /// lens.
    pub fn ray(&self, raster: Vec2, u_lens: Vec2, time: f32) -> CameraRay {
        if self.moves.is_none() {
            return self.ray_along(&self.axes, raster, u_lens);
        }
        let (axes, eye) = self.stand(time);
        let ray = self.ray_along(&axes, raster, u_lens);
        CameraRay { o: ray.o + eye, ..ray }
    }

    fn ray_along(&self, axes: &Mat3, raster: Vec2, u_lens: Vec2) -> CameraRay {
        let ndc = Vec2::new(raster.x / self.resolution.x - 0.5, 0.5 - raster.y / self.resolution.y);
        let film = ndc * self.window + self.offset;
        if self.orthographic {
            let o = *axes * film.extend(-self.near);
            return CameraRay { o, d: -axes.z_axis, t_max: self.far - self.near };
        }
        let mut o = Vec3::ZERO;
        let mut d = film.extend(-1.0);
        if self.has_depth_of_field() {
            o = (concentric_disk(u_lens) * self.lens_radius).extend(0.0);
            d = (d * self.focus_distance - o) / self.focus_distance;
        }
        // d.z = -1: t = depth along the view axis, which is what the clipping range measures.
        let length = d.length();
        CameraRay { o: *axes * (o + d * self.near), d: *axes * (d / length), t_max: (self.far - self.near) * length }
    }

    /// Width of a pixel at the origin of its ray, stage units, and how much it grows per stage unit.
    pub fn footprint(&self) -> (f32, f32) {
        let pixel = self.window.y / self.resolution.y;
        if self.orthographic { (pixel, 0.0) } else { (self.near * pixel, pixel) }
    }

    /// What turns first hits into depths and eye-space vectors.
    pub fn view(&self) -> View {
        View { origin: self.origin, axes: self.axes, clipping: [self.near, self.far], orthographic: self.orthographic }
    }

    /// Distance of a render-space point along the view axis, at a time of the shutter.
    pub fn depth(&self, p: Vec3, time: f32) -> f32 {
        if self.moves.is_none() {
            return -self.axes.z_axis.dot(p);
        }
        let (axes, eye) = self.stand(time);
        -axes.z_axis.dot(p - eye)
    }

    /// Where a render-space point is on the image (pixels, y down) at a time of the shutter; `None` behind the eye.
    pub fn raster(&self, p: Vec3, time: f32) -> Option<Vec2> {
        let (axes, eye) = self.stand(time);
        let p = axes.transpose() * (p - eye);
        if !self.orthographic && p.z >= 0.0 {
            return None;
        }
        let film = if self.orthographic { p.truncate() } else { p.truncate() / -p.z };
        let ndc = (film - self.offset) / self.window;
        film.is_finite().then(|| Vec2::new(ndc.x + 0.5, 0.5 - ndc.y) * self.resolution)
    }
}

/// A camera's place, without its lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// World position.
    pub origin: DVec3,
    /// Columns right, up, back, in world directions.
    pub axes: Mat3,
    /// Near and far distance along the view axis, stage units.
    pub clipping: [f32; 2],
    pub orthographic: bool,
}

impl View {
    /// A world position in eye space: x right, y up, looking along -z.
    pub fn eye_point(&self, p: Vec3) -> Vec3 {
        self.eye_vector((p.as_dvec3() - self.origin).as_vec3())
    }

    pub fn eye_vector(&self, v: Vec3) -> Vec3 {
        self.axes.transpose() * v
    }

    /// What a rasteriser's depth buffer holds (Hydra's `depth`): 0 at the near plane, 1 at the far one.
    pub fn device_depth(&self, depth: f32) -> f32 {
        let [near, far] = self.clipping.map(f64::from);
        let z = f64::from(depth).clamp(near, far);
        let t = (z - near) / (far - near);
        (if self.orthographic { t } else { t * far / z }) as f32
    }
}

/// The aperture made to fit the image's aspect (UsdRender `aspectRatioConformPolicy`).
fn conform(aperture: Vec2, aspect: f32, policy: &str) -> Vec2 {
    let wider = aspect > aperture.x / aperture.y;
    let adjust_width = match policy {
        "adjustApertureWidth" => true,
        "adjustApertureHeight" => false,
        "cropAperture" => !wider,
        "adjustPixelAspectRatio" => return aperture,
        _ => wider, // expandAperture
    };
    if adjust_width { Vec2::new(aperture.y * aspect, aperture.y) } else { Vec2::new(aperture.x, aperture.x / aspect) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(n: u32) -> RenderSettings {
        RenderSettings { resolution: [n, n], ..RenderSettings::default() }
    }

    #[test]
    fn apertures_are_tenths_of_a_unit() {
        let camera = flat::Camera {
            horizontal_aperture: 36.0,
            vertical_aperture: 36.0,
            focal_length: 18.0,
            clipping_range: [0.1, 1e6],
            ..Default::default()
        };
        let d = Camera::compile(&camera, &square(100)).ray(Vec2::new(100.0, 50.0), Vec2::ZERO, 0.0).d;
        assert!((d.x - 0.5_f32.sqrt()).abs() < 1e-6 && d.y.abs() < 1e-6 && d.z < 0.0);
        let camera = flat::Camera { projection: Projection::Orthographic, ..camera };
        let o = Camera::compile(&camera, &square(100)).ray(Vec2::new(0.0, 0.0), Vec2::ZERO, 0.0).o;
        assert!((o - Vec3::new(-1.8, 1.8, -0.1)).length() < 1e-6);
    }

    #[test]
    fn conform_policies() {
        let a = Vec2::new(20.0, 10.0);
        assert_eq!(conform(a, 4.0, "expandAperture"), Vec2::new(40.0, 10.0));
        assert_eq!(conform(a, 1.0, "expandAperture"), Vec2::new(20.0, 20.0));
        assert_eq!(conform(a, 4.0, "cropAperture"), Vec2::new(20.0, 5.0));
        assert_eq!(conform(a, 1.0, "cropAperture"), Vec2::new(10.0, 10.0));
        assert_eq!(conform(a, 4.0, "adjustApertureWidth"), Vec2::new(40.0, 10.0));
        assert_eq!(conform(a, 1.0, "adjustApertureWidth"), Vec2::new(10.0, 10.0));
        assert_eq!(conform(a, 4.0, "adjustApertureHeight"), Vec2::new(20.0, 5.0));
        assert_eq!(conform(a, 1.0, "adjustApertureHeight"), Vec2::new(20.0, 20.0));
        assert_eq!(conform(a, 4.0, "adjustPixelAspectRatio"), a);
    }

    #[test]
    fn data_window_counts_pixel_centres() {
        let all = DataWindow::from_ndc([10, 20], [0.0, 0.0, 1.0, 1.0]);
        assert_eq!(all, DataWindow { x0: 0, y0: 0, x1: 10, y1: 20 });
        let top_left = DataWindow::from_ndc([10, 20], [0.0, 0.75, 0.5, 1.0]);
        assert_eq!(top_left, DataWindow { x0: 0, y0: 0, x1: 5, y1: 5 });
        let overscan = DataWindow::from_ndc([10, 20], [-0.1, -0.1, 1.1, 1.2]);
        assert_eq!(overscan, DataWindow { x0: -1, y0: -4, x1: 11, y1: 22 });
        assert_eq!((overscan.width(), overscan.height()), (12, 26));
    }

    #[test]
    fn a_pixel_keeps_its_number() {
        let camera = Camera::compile(&flat::Camera::default(), &square(10));
        assert_eq!(camera.pixel_number(3, 2), 23);
        let mut outside: Vec<u32> =
            (-30..30).flat_map(|y| (-30..0).map(move |x| (x, y))).map(|(x, y)| camera.pixel_number(x, y)).collect();
        outside.sort_unstable();
        outside.dedup();
        assert!(outside.len() == 1800 && outside[0] >= 1 << 31);
    }

    /// UsdRender's words: the pixel is as wide as it takes to fit the aperture into the resolution.
    #[test]
    fn pixels_adjust_to_the_aperture() {
        let camera = flat::Camera { horizontal_aperture: 20.0, vertical_aperture: 10.0, ..Default::default() };
        let settings = RenderSettings { aspect_ratio_conform_policy: "adjustPixelAspectRatio".into(), ..square(100) };
        assert_eq!(Camera::compile(&camera, &settings).pixel_aspect_ratio, 2.0);
        assert_eq!(Camera::compile(&camera, &square(100)).pixel_aspect_ratio, 1.0);
    }

    #[test]
    fn depth_of_the_device() {
        let view = View { clipping: [1.0, 100.0], ..Camera::compile(&flat::Camera::default(), &square(8)).view() };
        assert_eq!([1.0, 100.0, 1e30].map(|z| view.device_depth(z)), [0.0, 1.0, 1.0]);
        // f (z - n) / (z (f - n))
        assert!((view.device_depth(2.0) - 100.0 / 198.0).abs() < 1e-6);
        assert_eq!(View { orthographic: true, ..view }.device_depth(50.5), 0.5);
    }

    #[test]
    fn points_at_focus_distance_stay_sharp() {
        let camera = flat::Camera { f_stop: 0.5, focus_distance: 7.0, ..Default::default() };
        let camera = Camera::compile(&camera, &square(64));
        let at = |u: Vec2| {
            let ray = camera.ray(Vec2::new(10.0, 50.0), u, 0.0);
            ray.o + ray.d * ((-7.0 - ray.o.z) / ray.d.z)
        };
        assert!((at(Vec2::new(0.1, 0.9)) - at(Vec2::new(0.8, 0.3))).length() < 1e-4);
    }
}
