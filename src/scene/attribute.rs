//! Values over the triangles of a mesh.

use super::triangulation::Triangulation;
use crate::flat::{AnyPrimvar, Interpolation, Primvar, array::Element};
use glam::{Vec2, Vec3, Vec4};

/// Values over a mesh, by the cheapest index that carries them.
#[derive(Debug, Clone, PartialEq)]
pub enum Attribute<T> {
    Constant(T),
    /// By point index.
    Point(Vec<T>),
    /// By triangle.
    Triangle(Vec<T>),
    /// By triangle and corner.
    Corner(Vec<[T; 3]>),
}

impl<T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>> Attribute<T> {
    /// Linear interpolation at barycentrics (1 - u - v, u, v).
    pub fn at(&self, triangle: usize, corners: [u32; 3], u: f32, v: f32) -> T {
        match self {
            Attribute::Constant(value) => *value,
            Attribute::Triangle(values) => values[triangle],
            _ => {
                let [a, b, c] = self.corners(triangle, corners);
                a * (1.0 - u - v) + b * u + c * v
            }
        }
    }

    /// Values at the corners of a triangle.
    pub fn corners(&self, triangle: usize, corners: [u32; 3]) -> [T; 3] {
        match self {
            Attribute::Constant(value) => [*value; 3],
            Attribute::Triangle(values) => [values[triangle]; 3],
            Attribute::Point(values) => corners.map(|i| values[i as usize]),
            Attribute::Corner(values) => values[triangle],
        }
    }

    /// Bytes beside the value itself.
    pub(super) fn memory(&self) -> usize {
        match self {
            Attribute::Constant(_) => 0,
            Attribute::Point(values) | Attribute::Triangle(values) => size_of_val(values.as_slice()),
            Attribute::Corner(values) => size_of_val(values.as_slice()),
        }
    }
}

/// A primvar that materials read, by its number of components.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    One(Attribute<f32>),
    Two(Attribute<Vec2>),
    Three(Attribute<Vec3>),
    Four(Attribute<Vec4>),
}

impl Values {
    pub(super) fn new(primvar: &AnyPrimvar, soup: &Triangulation) -> Self {
        match primvar {
            AnyPrimvar::Float(primvar) => Self::One(attribute(primvar, soup, |v| v)),
            AnyPrimvar::Float2(primvar) => Self::Two(attribute(primvar, soup, Vec2::from)),
            AnyPrimvar::Float3(primvar) => Self::Three(attribute(primvar, soup, Vec3::from)),
            AnyPrimvar::Float4(primvar) => Self::Four(attribute(primvar, soup, Vec4::from)),
        }
    }

    /// One number fills all lanes, a shorter vector has zeros behind it.
    pub fn at(&self, triangle: usize, corners: [u32; 3], u: f32, v: f32) -> Vec4 {
        match self {
            Self::One(values) => Vec4::splat(values.at(triangle, corners, u, v)),
            Self::Two(values) => values.at(triangle, corners, u, v).extend(0.0).extend(0.0),
            Self::Three(values) => values.at(triangle, corners, u, v).extend(0.0),
            Self::Four(values) => values.at(triangle, corners, u, v),
        }
    }

    pub(super) fn memory(&self) -> usize {
        fn bytes<T>(values: &Attribute<T>) -> usize {
            size_of::<T>()
                * match values {
                    Attribute::Constant(_) => 1,
                    Attribute::Point(values) | Attribute::Triangle(values) => values.len(),
                    Attribute::Corner(values) => 3 * values.len(),
                }
        }
        match self {
            Self::One(values) => bytes(values),
            Self::Two(values) => bytes(values),
            Self::Three(values) => bytes(values),
            Self::Four(values) => bytes(values),
        }
    }
}

/// From faces, points and corners of faces to those of triangles.
pub(super) fn attribute<T: Element, U: Copy>(
    primvar: &Primvar<T>,
    soup: &Triangulation,
    convert: impl Fn(T) -> U,
) -> Attribute<U> {
    let value = |i: usize| {
        let i = primvar.indices.as_ref().map_or(i, |indices| indices[i] as usize);
        convert(primvar.values[i])
    };
    match primvar.interpolation {
        Interpolation::Constant => Attribute::Constant(value(0)),
        Interpolation::Uniform => Attribute::Triangle(soup.faces.iter().map(|&f| value(f as usize)).collect()),
        Interpolation::Vertex | Interpolation::Varying => {
            let n = primvar.indices.as_ref().map_or(primvar.values.len(), |indices| indices.len());
            Attribute::Point((0..n).map(value).collect())
        }
        Interpolation::FaceVarying => {
            Attribute::Corner(soup.corners.iter().map(|c| c.map(|i| value(i as usize))).collect())
        }
    }
}
