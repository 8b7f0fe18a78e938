//! Two pictures of the same thing.

/// Differences per pixel and channel, row by row.
pub struct Difference {
    pixels: Vec<[f64; 3]>,
    /// Pixels on a side.
    size: usize,
}

impl Difference {
    pub fn new(pixels: Vec<[f64; 3]>) -> Self {
        let size = pixels.len().isqrt();
        assert_eq!(size * size, pixels.len());
        Self { pixels, size }
    }

    /// Of RGBA.
    pub fn of(a: &[f32], b: &[f32]) -> Self {
        let pixel = |(a, b): (&[f32], &[f32])| [0, 1, 2].map(|c| f64::from(a[c]) - f64::from(b[c]));
        Self::new(a.chunks(4).zip(b.chunks(4)).map(pixel).collect())
    }

    /// Sum over root of the squares: pixels are independent, and the expectation of each is zero.
    pub fn z(&self, wanted: impl Fn(usize, usize) -> bool, of: impl Fn(&[f64; 3]) -> f64) -> f64 {
        let pixels = self.pixels.iter().enumerate();
        let x = pixels.filter(|(i, _)| wanted(i % self.size, i / self.size)).map(|(_, d)| of(d));
        let (sum, squares) = x.fold((0.0, 0.0), |(sum, squares), x| (sum + x, squares + x * x));
        sum / squares.max(f64::MIN_POSITIVE).sqrt()
    }

    /// Of the quarters of the image and of all of it, channel by channel.
    pub fn tests(&self, label: &str) -> Vec<(String, f64)> {
        let half = self.size / 2;
        let quarter = |q: usize, c: usize| {
            (format!("{label}, quarter {q} channel {c}"), self.z(|x, y| x / half + 2 * (y / half) == q, |d| d[c]))
        };
        let quarters = (0..4).flat_map(|q| (0..3).map(move |c| quarter(q, c)));
        let whole = (0..3).map(|c| (format!("{label}, channel {c}"), self.z(|_, _| true, |d| d[c])));
        quarters.chain(whole).collect()
    }
}
